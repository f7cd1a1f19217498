"""The options that several stages use; a stage's own are in the `options.py` of its wing."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from pipeline.config.option import option


@dataclass(frozen=True)
class WorkOptions:
    """How and where a stage works, and whether it replaces what was made with other options."""

    overwrite: bool = option(
        False, "replace a finished dataset, run or export that was made with other options"
    )
    workers: int = option(1, "number of processes", at_least=1, at_most=1_000)
    executor: str = option(
        "local",
        "where processes run: local (this machine), dask (a new Dask cluster), or the address of a "
        "running one, such as tcp://host:8786",
        like=(
            r"local|dask|\S+:\S+",
            "local, dask, or the address of a Dask cluster, such as tcp://host:8786",
        ),
    )


@dataclass(frozen=True)
class SourceOptions:
    """Another dataset than the one in `data_dir`."""

    dataset: str | None = option(
        None,
        "dataset to use instead of data_dir: an id on the Hub, such as user/labyrinth, or a folder",
    )
    revision: str | None = option(None, "branch, tag or commit of the dataset on the Hub")


@dataclass(frozen=True)
class RunFolderOption:
    """Where trained policies are."""

    run_dir: str = option(
        "runs",
        "folder of trained policies; each size and task has a subfolder",
        is_local_folder=True,
    )


@dataclass(frozen=True)
class ResultsFolderOption:
    """Where the tables of results are."""

    results_dir: str = option(
        "results",
        "folder of the evaluations, and of the tables made from them",
        is_local_folder=True,
    )
    SUBMISSIONS: ClassVar = "submissions"
    """The subfolder for the results of submitted policies."""

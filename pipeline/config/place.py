"""The options of every run: what is done, where, and by how many processes."""

from __future__ import annotations

from dataclasses import dataclass

from labyrinth_core.data.storage import AnyPath, RemotePath, folder_at
from pipeline.config.dataset import DatasetOptions
from pipeline.config.errors import ConfigError, check
from pipeline.config.option import check_options, option

STAGES = {
    "build": "pipeline.generation.build",
    "validate": "pipeline.generation.validate",
    "analyse": "pipeline.analysis.analyse",
    "card": "pipeline.release.card",
    "report": "pipeline.analysis.report.stage",
    "publish": "pipeline.release.publish",
    "train": "pipeline.training.train",
    "evaluate": "pipeline.training.evaluate",
    "results": "pipeline.training.results.stage",
    "environments": "pipeline.analysis.environments.stage",
}
"""Stage -> the module whose `run` performs it."""


@dataclass(frozen=True)
class PlaceOptions(DatasetOptions):
    """Where and how a dataset is made."""

    data_dir: str = option(
        "data/labyrinth",
        "folder of the dataset, or a URL such as s3://bucket/name; each size and task is a folder "
        "in it",
        folder=True,
    )
    run_dir: str = option(
        "runs", "folder of what is trained; each size and task is a folder in it", folder=True
    )
    overwrite: bool = option(
        False, "replace a finished dataset or run that was made with other options"
    )
    workers: int = option(1, "processes", at_least=1, at_most=1_000)
    executor: str = option(
        "local",
        "where they run: local (this machine), dask or ray",
        one_of=("local", "dask", "ray"),
    )
    executor_address: str | None = option(
        None, "address of a running cluster of Dask or Ray; else one is started for the run"
    )
    stages: tuple[str, ...] = option(
        (), "what to do, in order: " + ", ".join(STAGES), one_of=STAGES
    )


def place_of(options: PlaceOptions) -> AnyPath:
    """Return the data_dir that checked options name.

    Raises:
        ConfigError: An option is impossible.
    """
    check_options(options, PlaceOptions)
    check(
        options.executor_address is None or options.executor != "local",
        f"executor_address={options.executor_address}: executor=local has none",
    )
    try:
        folder = folder_at(options.data_dir)
    except ValueError as error:
        raise ConfigError(f"data_dir={error}") from error
    # Workers of a cluster need not be where this process is.
    if isinstance(folder, RemotePath) or options.executor == "local":
        return folder
    return folder.absolute()

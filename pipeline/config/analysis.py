"""The options of the stage `analyse`."""

from __future__ import annotations

from dataclasses import dataclass

from pipeline.config.option import option


@dataclass(frozen=True)
class LeakageOptions:
    """A dataset to analyse instead of the dataset of the run."""

    source: str | None = option(
        None,
        "dataset to analyse instead: a .labyrinth or .npy file, a folder of such files by split, "
        "or a dataset with the column info, in a folder or on the Hub",
    )
    config: str | None = option(None, "config of that dataset, if it has several")

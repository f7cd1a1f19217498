"""The options of the stage `analyse`."""

from __future__ import annotations

from dataclasses import dataclass

from pipeline.config.option import option


@dataclass(frozen=True)
class LeakageOptions:
    """A dataset to analyse instead of the dataset of the run."""

    source: str | None = option(
        None,
        "dataset from elsewhere to analyse: a file or a folder of .labyrinth or .npy files "
        "by split, or any folder or id on the Hub with the column info",
    )
    config: str | None = option(None, "config of that dataset, if it has several")

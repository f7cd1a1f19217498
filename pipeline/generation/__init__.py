"""Make and validate datasets: sample, solve, render and write, composed by `build`.

Every labyrinth is a pure function of the config and its structure, so `check` makes it again.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from labyrinth_core.data import Dataset, DatasetConfig


def built(config: DatasetConfig, data_dir: Path, workers: int = 1) -> Dataset:
    """Build a dataset as the stage `build` does, without its summary, and return it.

    Args:
        config: The config of the dataset.
        data_dir: The folder of datasets.
        workers: The number of processes.
    """
    from labyrinth_core.data import Dataset
    from pipeline.config import Job
    from pipeline.generation.build import build
    from pipeline.generation.options import BuildOptions

    job = Job(BuildOptions(workers=workers), config, data_dir, str(data_dir))
    build(job)
    return Dataset.at(job.folder)

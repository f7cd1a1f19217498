"""The dataset that a run learns from or is judged on."""

from __future__ import annotations

import zlib
from importlib.metadata import version

import numpy as np

from labyrinth_core.data.datasets import Dataset
from labyrinth_core.pictures.png import ENCODER
from labyrinth_core.version import __version__
from pipeline.config.errors import ConfigError, check
from pipeline.config.options import SourceOptions, source_of
from pipeline.config.stage import Job


def dataset_of(job: Job[SourceOptions], train_labyrinths: int | None = None) -> Dataset:
    """Return the dataset that a stage reads.

    Args:
        job: The options that name the dataset.
        train_labyrinths: The number of labyrinths to learn from, which train must have.

    Raises:
        ConfigError: A folder is given with a revision, or train has too few labyrinths.
        DatasetError: The dataset does not exist.
    """
    source, revision = source_of(job), job.options.revision
    if job.options.dataset is None:
        job.require_dataset()
    try:
        data = Dataset(source, job.dataset.name, revision)
    except ValueError as error:
        raise ConfigError(str(error)) from error
    if train_labyrinths is not None:
        most = sum(shard.labyrinths for shard in data.manifest.of("train"))
        check(
            train_labyrinths <= most,
            f"train_labyrinths={train_labyrinths}: give {most} or fewer, as many as train of "
            f"{source} has",
        )
    return data


def build_versions() -> dict[str, str]:
    """Return the versions of the software that determines the bytes of a dataset."""
    return {
        "labyrinth-datasets": __version__,
        "numpy": np.__version__,
        "pyarrow": version("pyarrow"),
        "zlib": zlib.ZLIB_RUNTIME_VERSION,
        "png": ENCODER,
    }

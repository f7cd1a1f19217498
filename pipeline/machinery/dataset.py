"""The dataset that a run learns from or is judged on."""

from __future__ import annotations

import zlib
from importlib.metadata import version

import numpy as np

from labyrinth_core.data.dataset import locate
from labyrinth_core.data.manifest import Manifest
from labyrinth_core.pictures.png import LEVEL, REPEAT_LEVEL
from labyrinth_core.version import __version__
from pipeline.config.errors import ConfigError, check
from pipeline.config.options import SourceOptions, source_of
from pipeline.config.stage import Job


def manifest_of(job: Job[SourceOptions], train_labyrinths: int | str | None = None) -> Manifest:
    """Return the manifest of the dataset that a stage reads.

    Args:
        job: The dataset.
        train_labyrinths: The number of labyrinths to learn from, which train must have; None for
            all, "fresh" for new ones.

    Raises:
        ConfigError: A folder is given with a revision, or train has too few labyrinths.
        DatasetError: The dataset does not exist.
    """
    source, revision = source_of(job), job.options.revision
    if job.options.dataset is None:
        job.require_dataset()
    try:
        folder = locate(source, job.dataset.name, [], revision)
    except ValueError as error:
        raise ConfigError(str(error)) from error
    manifest = Manifest.read(folder)
    if isinstance(train_labyrinths, int):
        most = sum(shard.labyrinths for shard in manifest.of("train"))
        check(
            train_labyrinths <= most,
            f"train_labyrinths={train_labyrinths}: give {most} or fewer, as many as train of "
            f"{source} has",
        )
    return manifest


def build_versions() -> dict[str, str]:
    """Return the versions of the software that determines the bytes of a dataset."""
    return {
        "labyrinth-datasets": __version__,
        "numpy": np.__version__,
        "pyarrow": version("pyarrow"),
        "zlib": zlib.ZLIB_RUNTIME_VERSION,
        "png": f"own encoder, deflate levels {LEVEL} and {REPEAT_LEVEL}",
    }

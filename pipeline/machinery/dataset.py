"""The dataset that a run learns from or is judged on."""

from __future__ import annotations

import zlib
from importlib.metadata import version

import numpy as np

from labyrinth_core.data.dataset import locate
from labyrinth_core.data.errors import DatasetError
from labyrinth_core.data.manifest import MANIFEST, Manifest
from labyrinth_core.pictures.png import LEVEL, REPEAT_LEVEL
from labyrinth_core.version import __version__
from pipeline.config.errors import ConfigError, as_typed, check
from pipeline.config.run import Run

WHOLE_FOLDER = ("card", "report", "publish")
"""The stages that work on all datasets of a folder, whatever `size` and `task` are."""


def check_there(run: Run) -> None:
    """Check that the dataset that a command names exists, before a stage of the whole folder.

    Raises:
        DatasetError: The dataset does not exist.
    """
    stages = {*run.options.stages}
    if not run.options.publish.repo_id:  # A policy's dataset, for example, is on the Hub.
        stages.discard("publish")
    if run.names_dataset and stages & {*WHOLE_FOLDER} and "build" not in stages:
        _check_there(run)


def _check_there(run: Run) -> None:
    if not (run.folder / MANIFEST).is_file():
        size = f"size={run.dataset.height}x{run.dataset.width} task={run.dataset.task}"
        command = f"labyrinth-datasets {size} {as_typed('data_dir', str(run.data_dir))}"
        raise DatasetError(f"{run.folder} holds no dataset: {command} makes it")


def manifest_of(run: Run) -> Manifest:
    """Return the manifest of the dataset of a run.

    Raises:
        ConfigError: A folder is given with a revision, or train has too few labyrinths.
        DatasetError: The dataset does not exist.
    """
    options = run.options
    if run.options.dataset is None:
        _check_there(run)
    try:
        folder = locate(run.source, run.dataset.name, [], options.revision)
    except ValueError as error:
        raise ConfigError(str(error)) from error
    manifest = Manifest.read(folder)
    asked, most = options.train_labyrinths, sum(s.labyrinths for s in manifest.of("train"))
    check(
        asked is None or asked <= most,
        f"train_labyrinths={asked}: give {most} or fewer, as many as train of {run.source} has",
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

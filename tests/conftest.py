"""What all tests share: examples that are the same in every run, no network, small datasets.

The library `datasets` reads where its cache lies when it is imported, so that is settled first.
"""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, settings

from labyrinth_core.world.labyrinth import Task
from pipeline.config.dataset import BucketsConfig
from pipeline.config.run import Run, RunConfig, resolve
from pipeline.generation import build as generation

settings.register_profile(
    "house",
    deadline=None,
    derandomize=True,
    database=None,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large],
)
settings.register_profile("fast", settings.get_profile("house"), max_examples=25)
settings.load_profile("house")

_private = pytest.StashKey[Path]()


def pytest_configure(config: pytest.Config) -> None:
    if config.option.markexpr == "not slow":
        settings.load_profile("fast")
    folder = Path(tempfile.mkdtemp(prefix="labyrinth-tests-"))
    config.stash[_private] = folder
    os.environ["HF_HUB_OFFLINE"] = "1"
    os.environ["HF_HOME"] = str(folder / "huggingface")
    os.environ["XDG_CACHE_HOME"] = str(folder / "cache")
    os.environ["HF_DATASETS_CACHE"] = str(folder / "huggingface" / "datasets")


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Leave a file whose tests are all slow unread in the fast lane.

    Importing what such files need (Dask, a server of S3) takes longer than many tests.
    """
    if config.option.markexpr != "not slow" or collection_path.suffix != ".py":
        return None
    return "\npytestmark = pytest.mark.slow\n" in collection_path.read_text("utf-8") or None


def pytest_unconfigure(config: pytest.Config) -> None:
    shutil.rmtree(config.stash[_private], ignore_errors=True)


def run_of(data_dir: Path, **options: Any) -> Run:
    """Return the run with the options of `RunConfig`; a small one where they say nothing."""
    if "buckets" in options:
        options["buckets"] = BucketsConfig(*options["buckets"])
    small = {"stages": ["build"], "size": "3", "labyrinths": 8, "data_dir": str(data_dir)}
    return resolve(RunConfig(**small | options))


@pytest.fixture(scope="session")
def make_run() -> Callable[..., Run]:
    return run_of


@pytest.fixture(scope="session")
def build() -> Callable[..., Run]:
    """A function that builds a dataset, by default 3x3 with 8 labyrinths a split."""

    def build_dataset(
        data_dir: Path,
        *,
        cells_per_shard: int = generation.CELLS_PER_SHARD,
        cells_per_chunk: tuple[int, int] = generation.CELLS_PER_CHUNK,
        **options: Any,
    ) -> Run:
        run = run_of(data_dir, **options)
        generation.run(run, cells_per_shard=cells_per_shard, cells_per_chunk=cells_per_chunk)
        return run

    return build_dataset


@pytest.fixture(scope="session")
def small_dataset(build: Callable[..., Run], tmp_path_factory: pytest.TempPathFactory) -> Run:
    """A finished 3x3 dataset with 8 labyrinths a split; copy it before you change it."""
    return build(tmp_path_factory.mktemp("small") / "labyrinth")


@pytest.fixture(scope="session")
def datasets(build: Callable[..., Run], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a dataset of three rows and four columns for each task."""
    folder = tmp_path_factory.mktemp("tasks") / "labyrinth"
    for task in Task:
        build(folder, size="3x4", task=str(task), labyrinths=5, solutions="all", random_steps=20)
    return folder

"""Datasets with a card, small enough to be made for these tests."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from hub.fixture import local_hub

from pipeline.config import RunConfig, TaskConfig, resolve
from pipeline.generation import build
from pipeline.release import card

__all__ = ["local_hub"]


def make(data_dir: Path, size: str, task: str = "navigation", **options: object) -> Path:
    """Build a dataset and return its folder."""
    config = RunConfig(
        stages=["build"], size=size, task=TaskConfig(task), data_dir=str(data_dir), **options
    )
    run = resolve(config)
    build.run(run)
    return run.folder


def make_both(data_dir: Path) -> Path:
    """Build the two datasets of these tests, write their card, and return the folder of both."""
    make(data_dir, "3x3", labyrinths=7, random_steps=25)
    make(data_dir, "3x4", "key_and_door", labyrinths=3, random_steps=25, solutions="all")
    card.write_card(data_dir)
    return data_dir


@pytest.fixture(scope="session")
def carded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of two datasets with their card; not to be changed."""
    return make_both(tmp_path_factory.mktemp("carded") / "labyrinth")


@pytest.fixture
def folder(carded: Path, tmp_path: Path) -> Path:
    """A copy of it, to be changed."""
    return Path(shutil.copytree(carded, tmp_path / "copy"))


@pytest.fixture(scope="session")
def build_dataset() -> Callable[..., Path]:
    """The function that builds one dataset more."""
    return make


@pytest.fixture(scope="session")
def built_to_release(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Folders of tiny datasets: one, the same with another `random`, the same and one more."""
    folders = {}
    for name, steps in {"one": 5, "other_shard": 6, "two": 5}.items():
        folders[name] = tmp_path_factory.mktemp(name) / "labyrinth"
        make(folders[name], "2x3", labyrinths=3, random_steps=steps)
    make(folders["two"], "3x3", "icy_floor", labyrinths=2, random_steps=5)
    return folders


@pytest.fixture
def releasable(built_to_release: dict[str, Path], tmp_path: Path) -> Path:
    """A copy of one tiny dataset, without its card."""
    return Path(shutil.copytree(built_to_release["one"], tmp_path / "labyrinth"))


@pytest.fixture(scope="session")
def other_shard(built_to_release: dict[str, Path]) -> Path:
    """The same with another shard of the split random; not to be changed."""
    return built_to_release["other_shard"]


@pytest.fixture(scope="session")
def with_one_more(built_to_release: dict[str, Path]) -> Path:
    """The same with one config more; not to be changed."""
    return built_to_release["two"]

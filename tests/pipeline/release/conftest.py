"""Datasets with a card, small enough to be made for these tests."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest
from hub.local_hub import LocalHub
from support.making import Run, RunConfig, make, perform, resolve
from support.publishing import local_hub, published

from pipeline.release.card import write_card

__all__ = ["local_hub"]


@pytest.fixture(scope="session")
def carded(both: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of two datasets with their card; not to be changed."""
    folder = Path(shutil.copytree(both, tmp_path_factory.mktemp("carded") / "labyrinth"))
    write_card(folder)
    return folder


@pytest.fixture
def folder(carded: Path, tmp_path: Path) -> Path:
    """A copy of it, to be changed."""
    return Path(shutil.copytree(carded, tmp_path / "copy"))


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
def release(built_to_release: dict[str, Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a Hub on which one tiny dataset is released as 1.0.0; not to be changed."""
    place = tmp_path_factory.mktemp("release")
    shutil.copytree(built_to_release["one"], place / "labyrinth")
    with LocalHub(place / "hub") as hub:
        published(hub, place / "labyrinth")
    return place


@pytest.fixture
def released(release: Path, tmp_path: Path) -> Path:
    """A copy of the dataset that is released as 1.0.0."""
    return Path(shutil.copytree(release / "labyrinth", tmp_path / "released"))


@pytest.fixture
def released_hub(release: Path, tmp_path: Path) -> Iterator[LocalHub]:
    """Yield a copy of the Hub on which it is released."""
    copy = tmp_path / "released-hub"
    shutil.copytree(release / "hub", copy, ignore=shutil.ignore_patterns("homes", "temporary"))
    with LocalHub(copy) as hub:
        yield hub
    assert not hub.failures, "\n".join(hub.failures)


@pytest.fixture(scope="session")
def other_shard(built_to_release: dict[str, Path]) -> Path:
    """The same with another shard of the split random; not to be changed."""
    return built_to_release["other_shard"]


@pytest.fixture(scope="session")
def with_one_more(built_to_release: dict[str, Path]) -> Path:
    """The same with one config more; not to be changed."""
    return built_to_release["two"]


TOY = {"epochs": 1, "pictures": 64, "channels": 8, "iterations": 9, "average": False}


@pytest.fixture(scope="session")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """The run of a small planner that was trained and evaluated; not to be changed."""
    from pipeline.training import train

    place = tmp_path_factory.mktemp("trained")
    make(place / "labyrinth", "3x3", labyrinths=6, random_steps=5)
    options = RunConfig(
        stages=["train", "evaluate"],
        size="3",
        data_dir=str(place / "labyrinth"),
        run_dir=str(place / "runs"),
        method={"name": "planner", **TOY},
        device="cpu",
        threads=1,
    )
    run = resolve(options)
    train.run(run)
    perform("evaluate", run)
    return run

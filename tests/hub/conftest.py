"""A Hub on loopback with which this process talks."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from support.making import make
from support.publishing import REPO, connected

from hub.local_hub import LocalHub

CONFIG = "2x3"


@pytest.fixture(scope="session")
def versions(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Two datasets of one config, whose rows differ; not to be changed."""
    folders = [tmp_path_factory.mktemp("old"), tmp_path_factory.mktemp("new")]
    for seed, folder in enumerate(folders):
        make(folder, CONFIG, labyrinths=3, random_steps=5, seed=seed)
    return folders


@pytest.fixture
def faulty(versions: list[Path], tmp_path: Path) -> Iterator[LocalHub]:
    """Yield a Hub with the older dataset, which this process reads with an empty cache."""
    with LocalHub(tmp_path / "hub") as hub, connected(hub):
        put(hub, versions[0])
        yield hub
    assert not hub.failures, "\n".join(hub.failures)


def put(hub: LocalHub, folder: Path) -> None:
    """Let somebody commit a dataset to the Hub, file by file."""
    if not hub.has(REPO):
        hub.create_repo(REPO)
    for path in sorted(folder.glob(f"{CONFIG}/*")):
        hub.commit(REPO, path.relative_to(folder).as_posix(), path.read_bytes())

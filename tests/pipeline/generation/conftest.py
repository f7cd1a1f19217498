"""The dataset that the tests of validation damage."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from support.making import Run


@pytest.fixture(scope="session")
def tiny(build: Callable[..., Run], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a dataset with three labyrinths a split."""
    return build(tmp_path_factory.mktemp("tiny"), labyrinths=3, random_steps=30).folder


@pytest.fixture
def folder(tiny: Path, tmp_path: Path) -> Path:
    """A copy of it, to be tampered with."""
    return Path(shutil.copytree(tiny, tmp_path / tiny.name))

"""Two small datasets."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from support.making import make_both


@pytest.fixture(scope="session")
def both(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of two datasets; not to be changed."""
    return make_both(tmp_path_factory.mktemp("both") / "labyrinth")


@pytest.fixture
def folder(both: Path, tmp_path: Path) -> Path:
    """A copy of it, to be changed."""
    return Path(shutil.copytree(both, tmp_path / "copy"))

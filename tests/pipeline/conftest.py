"""Two small datasets with their card."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from support.making import make_both


@pytest.fixture(scope="session")
def carded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of two datasets with their card; not to be changed."""
    return make_both(tmp_path_factory.mktemp("carded") / "labyrinth")


@pytest.fixture
def folder(carded: Path, tmp_path: Path) -> Path:
    """A copy of it, to be changed."""
    return Path(shutil.copytree(carded, tmp_path / "copy"))

"""A dataset with questions beside it, for the tests of questions and of their card."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from support.making import Run, perform
from support.tampering import content_of

NAME = "3x4-key_and_door"
TEST = "test-00000-of-00001.parquet"
SHIFTS = ("recoloured",)
OPTIONS = {"size": "3x4", "task": "key_and_door", "shifts": SHIFTS, "open_walls": 0.5}
SPLITS = ["test", "s0", "s0_and_g", *SHIFTS]


@pytest.fixture(scope="module")
def asked(build: Callable[..., Run], tmp_path_factory: pytest.TempPathFactory) -> Run:
    """The run of a dataset whose questions are there; copy its folder before you change it."""
    run = build(tmp_path_factory.mktemp("asked") / "data", labyrinths=4, **OPTIONS)
    before = content_of(run.folder)
    perform("questions", run)
    assert content_of(run.folder) == before
    return run


@pytest.fixture
def copied(asked: Run, tmp_path: Path, make_run: Callable[..., Run]) -> Run:
    """The same run in a folder of its own."""
    shutil.copytree(asked.data_dir, tmp_path / "data")
    return make_run(tmp_path / "data", labyrinths=4, **OPTIONS)

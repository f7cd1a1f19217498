"""Small datasets to learn from, one a task."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from labyrinth_core.labyrinth import Task
from pipeline.config import Run


@pytest.fixture(scope="session")
def datasets(build: Callable[..., Run], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a dataset of three rows and four columns for each task."""
    folder = tmp_path_factory.mktemp("tasks") / "labyrinth"
    for task in Task:
        build(folder, size="3x4", task=str(task), labyrinths=5, solutions="all", random_steps=20)
    return folder

"""Small datasets to learn from, one a task."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from labyrinth_core.labyrinth import Task
from pipeline.config import Run
from pipeline.training.method import Problem
from pipeline.training.networks import NetworkSpec
from pipeline.training.steps import load_steps
from pipeline.training.worlds import load_worlds

torch.set_num_threads(1)


@pytest.fixture(scope="session")
def datasets(build: Callable[..., Run], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a dataset of three rows and four columns for each task."""
    folder = tmp_path_factory.mktemp("tasks") / "labyrinth"
    for task in Task:
        build(folder, size="3x4", task=str(task), labyrinths=5, solutions="all", random_steps=20)
    return folder


@pytest.fixture(scope="session")
def problem_of(small_dataset: Run) -> Callable[..., Problem]:
    """A function that returns what methods learn from: eight labyrinths of 3x3."""
    folder = small_dataset.data_dir
    worlds = {
        encoder: load_worlds(folder, "3x3", "train", observation=sees)
        for encoder, sees in (("mlp", "vector"), ("cnn", "image"))
    }
    demonstrations, exploration = (
        load_steps(folder, "3x3", split, worlds["mlp"]) for split in ("train", "random")
    )

    def make(seed: int = 0, encoder: str = "mlp", **changed: Any) -> Problem:
        torch.manual_seed(seed)
        problem = Problem(
            worlds=worlds[encoder],
            observations=torch.tensor(worlds[encoder].observations),
            demonstrations=demonstrations,
            exploration=lambda: exploration,
            spec=NetworkSpec(encoder, 1, 3, 3, "navigation"),
            rng=np.random.default_rng(seed),
        )
        return replace(problem, **changed)

    return make

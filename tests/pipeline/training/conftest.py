"""A small problem for the tests of training."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch

from labyrinth_core.evaluation.labyrinth_arrays import load_arrays
from labyrinth_core.policies.spec import NetworkSpec
from pipeline.config.run import Run
from pipeline.training.methods.acting import load_steps
from pipeline.training.methods.method import Problem

torch.set_num_threads(1)


@pytest.fixture(scope="session")
def problem_of(small_dataset: Run) -> Callable[..., Problem]:
    """A function that returns a problem with eight labyrinths of 3x3."""
    folder = small_dataset.data_dir
    arrays = {
        encoder: load_arrays(folder, "3x3", "train", observation=sees)
        for encoder, sees in (("mlp", "vector"), ("cnn", "image"))
    }
    demonstrations, exploration = (
        load_steps(folder, "3x3", split, arrays["mlp"]) for split in ("train", "random")
    )

    def make(seed: int = 0, encoder: str = "mlp", **changed: Any) -> Problem:
        torch.manual_seed(seed)
        problem = Problem(
            arrays=arrays[encoder],
            observations=torch.tensor(arrays[encoder].observations),
            demonstrations=demonstrations,
            exploration=lambda: exploration,
            spec=NetworkSpec(encoder, 1, 3, 3, "navigation"),
            rng=np.random.default_rng(seed),
        )
        return replace(problem, **changed)

    return make

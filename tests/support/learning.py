"""Fixtures: a small problem to learn, and what the tests of methods have in common."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from labyrinth_core import load_arrays
from labyrinth_core.data import Dataset
from labyrinth_core.learning import Learner, NetworkSpec, Problem
from pipeline.training import loop
from pipeline.training.identity import find
from support.making import Run

torch.set_num_threads(1)


@pytest.fixture(scope="session")
def problem_of(small_dataset: Run) -> Callable[..., Problem]:
    """A function that returns a problem with eight labyrinths of 3x3."""
    data = Dataset.at(small_dataset.folder)
    problems = {
        encoder: Problem.of_dataset(
            data,
            load_arrays(small_dataset.data_dir, "3x3", "train", observation=sees),
            NetworkSpec(encoder, 3, 3, "navigation"),
            learner="a test",
        )
        for encoder, sees in (("mlp", "vector"), ("cnn", "image"))
    }
    explored = problems["mlp"].exploration()

    def make(seed: int = 0, encoder: str = "mlp", **changed: Any) -> Problem:
        torch.manual_seed(seed)
        given = {"rng": np.random.default_rng(seed), "exploration": lambda: explored}
        return replace(problems[encoder], **given | changed)

    return make


def method_of(name: str) -> Any:
    """Return the class of a method."""
    return find(name, {})[0]


def settings_of(name: str, **values: Any) -> Any:
    """Return the settings of a method: those given, the others by default."""
    return find(name, values)[1]


def learner_of(name: str, problem: Problem, **values: Any) -> Any:
    """Return a fresh learner of a method, with the settings given, the others by default."""
    method, settings = find(name, values)
    return method(problem, settings)


def equal_weights(left: Mapping[str, torch.Tensor], right: Mapping[str, torch.Tensor]) -> bool:
    """Return whether two networks have the same weights."""
    return all(torch.equal(each, right[name]) for name, each in left.items())


@pytest.fixture
def require_reproducible(tmp_path: Path) -> Callable[[Callable[[int], Learner]], None]:
    """A function that fails unless weights follow from the seed, and from a checkpoint."""

    path = tmp_path / "checkpoint"

    def after_two_epochs(learner: Learner) -> dict[str, torch.Tensor]:
        learner.epoch()
        if not path.exists():
            loop.save_checkpoint(path, learner, loop.Progress(), {})
        learner.epoch()
        return learner.policy.state_dict()

    def require(learner_of: Callable[[int], Learner]) -> None:
        whole, again, other = (after_two_epochs(learner_of(seed)) for seed in (0, 0, 1))
        resumed = learner_of(5)
        loop.load_checkpoint(path, resumed, {})
        resumed.epoch()
        assert equal_weights(whole, again)
        assert equal_weights(whole, resumed.policy.state_dict())
        assert not equal_weights(whole, other)

    return require


def states_seen_by(learner: Learner, epochs: int) -> NDArray[np.int64]:
    """Train for some epochs, and return the states that the learner looks at to learn.

    Those of `Learner.outputs` are left out: it computes labels and values of all states.
    """
    original = Learner.outputs

    def outputs(*arguments: Any) -> torch.Tensor:
        count = len(see.call_args_list)
        computed = original(*arguments)
        del see.call_args_list[count:]
        return computed

    with (
        patch.object(Learner, "see", autospec=True, side_effect=Learner.see) as see,
        patch.object(Learner, "outputs", outputs),
    ):
        for _ in range(epochs):
            learner.epoch()
    return np.concatenate([call.args[1] for call in see.call_args_list])


def targets_of(learner: Any) -> list[float]:
    """Take a gradient step of a method with a squared error, and return the targets."""
    functional = torch.nn.functional
    with patch.object(functional, "mse_loss", side_effect=functional.mse_loss) as loss:
        learner.update()
    targets: list[float] = loss.call_args.args[1].tolist()
    return targets

"""An interrupted run continues exactly where it was."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest
import torch
from learning import settings_of
from safetensors import safe_open

from labyrinth_core.data.errors import DatasetError
from pipeline.training import checkpoint
from pipeline.training.checkpoint import Progress, state_of
from pipeline.training.methods import bc
from pipeline.training.methods.method import Learner, Problem

pytestmark = pytest.mark.slow

Problems = Callable[..., Problem]


def learner(problem: Problem) -> bc.Method:
    return bc.Method(problem, settings_of("bc"))


def same(left: Learner, right: Learner) -> bool:
    (tensors, plain), (others, other_plain) = state_of(left), state_of(right)
    if json.dumps(plain) != json.dumps(other_plain) or set(tensors) != set(others):
        return False
    return all(torch.equal(tensor, others[name]) for name, tensor in tensors.items())


def test_a_checkpoint_holds_weights_moments_randomness_and_history(
    problem_of: Problems, tmp_path: Path
) -> None:
    path = tmp_path / "checkpoint"
    first = learner(problem_of(0, "cnn"))
    first.epoch()
    weights = {name: tensor.clone() for name, tensor in first.policy.state_dict().items()}
    told = Progress(3, 1.5, [{"epoch": 3, "loss": 0.25}], {"epoch": 3}, 2, weights)
    checkpoint.save(path, first, told, {"run": 1})
    assert [each.name for each in tmp_path.iterdir()] == ["checkpoint"]
    with safe_open(path, framework="pt") as file:  # A format that holds no code.
        assert "policy/classifier.0.weight" in file.keys()  # noqa: SIM118
    uninterrupted = [first.epoch() for _ in range(2)]

    second = learner(problem_of(99, "cnn"))
    assert not same(first, second)
    progress = checkpoint.load(path, second, {"run": 1})
    assert (progress.epoch, progress.history, progress.stale) == (3, told.history, 2)
    assert all(torch.equal(each, weights[name]) for name, each in progress.weights.items())
    assert [second.epoch() for _ in range(2)] == uninterrupted
    assert same(first, second)


def test_the_checkpoint_of_another_run_is_refused(problem_of: Problems, tmp_path: Path) -> None:
    path = tmp_path / "checkpoint"
    checkpoint.save(path, learner(problem_of()), Progress(), {"seed": 0, "encoder": "cnn"})
    with pytest.raises(DatasetError, match="seed=0, not 1: choose another run_dir"):
        checkpoint.load(path, learner(problem_of()), {"seed": 1, "encoder": "cnn"})

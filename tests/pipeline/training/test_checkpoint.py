"""An interrupted run continues exactly where it was."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors import safe_open
from support.learning import learner_of

from labyrinth_core.errors import DatasetError
from labyrinth_core.learning import Learner, Problem
from labyrinth_core.policies import read_tensors
from pipeline.training import loop

pytestmark = pytest.mark.slow

Problems = Callable[..., Problem]


def learner(problem: Problem) -> Learner:
    made: Learner = learner_of("bc", problem)
    return made


def state_in(learner: Learner, folder: Path) -> dict[str, str]:
    """Return the header of a checkpoint of a learner: its values, and a hash of all tensors."""
    path = folder / "state"
    loop.save_checkpoint(path, learner, loop.Progress(), {})
    header = read_tensors(path)[1]
    path.unlink()
    return header


def test_a_checkpoint_holds_weights_moments_randomness_and_history(
    problem_of: Problems, tmp_path: Path
) -> None:
    path = tmp_path / "checkpoint"
    first = learner(problem_of(0, "cnn"))
    first.epoch()
    weights = {name: tensor.clone() for name, tensor in first.policy.state_dict().items()}
    told = loop.Progress(3, 1.5, [{"epoch": 3, "loss": 0.25}], {"epoch": 3}, 2, weights)
    loop.save_checkpoint(path, first, told, {"run": 1})
    assert [each.name for each in tmp_path.iterdir()] == ["checkpoint"]
    with safe_open(path, framework="pt") as file:  # A format that holds no code.
        assert "policy/classifier.0.weight" in file.keys()  # noqa: SIM118
    uninterrupted = [first.epoch() for _ in range(2)]
    state = state_in(first, tmp_path)

    second = learner(problem_of(99, "cnn"))
    progress = loop.load_checkpoint(path, second, {"run": 1})
    assert (progress.epoch, progress.history, progress.stale) == (3, told.history, 2)
    assert all(torch.equal(each, weights[name]) for name, each in progress.weights.items())
    assert [second.epoch() for _ in range(2)] == uninterrupted
    assert state_in(second, tmp_path) == state


def test_the_checkpoint_of_another_run_is_refused(problem_of: Problems, tmp_path: Path) -> None:
    path = tmp_path / "checkpoint"
    identity = {"seed": 0, "encoder": "cnn"}
    loop.save_checkpoint(path, learner(problem_of()), loop.Progress(), identity)
    with pytest.raises(DatasetError, match="seed=0, not 1: choose another run_dir"):
        loop.load_checkpoint(path, learner(problem_of()), identity | {"seed": 1})


def test_a_checkpoint_with_a_flipped_bit_is_refused_in_one_line(
    problem_of: Problems, tmp_path: Path
) -> None:
    path, trained = tmp_path / "checkpoint", learner(problem_of())
    trained.epoch()
    loop.save_checkpoint(path, trained, loop.Progress(1, 1.5, [{"epoch": 1}]), {"seed": 0})
    whole = path.read_bytes()
    header = int.from_bytes(whole[:8], "little")
    rng = np.random.default_rng(0)
    places = [*range(8), *rng.integers(8, header, 150), *rng.integers(header, len(whole), 30)]
    for place in map(int, places):
        damaged = bytearray(whole)
        damaged[place] ^= 1 << int(rng.integers(8))
        path.write_bytes(damaged)
        for read in (
            lambda: loop.load_checkpoint(path, learner(problem_of()), {"seed": 0}),
            lambda: loop.identity_in(path),
        ):
            with pytest.raises(DatasetError, match=rf"\A{path} [^\n]*; remove it to start again"):
                read()
    for content in (b"", whole[: len(whole) // 2], whole + b"x"):
        path.write_bytes(content)
        with pytest.raises(DatasetError, match=rf"\A{path} [^\n]*; remove it to start again"):
            loop.identity_in(path)
    path.write_bytes(whole)
    assert loop.load_checkpoint(path, learner(problem_of()), {"seed": 0}).epoch == 1


def test_a_dataset_that_has_moved_does_not_end_an_interrupted_run(
    problem_of: Problems, tmp_path: Path
) -> None:
    path = tmp_path / "checkpoint"
    identity = {"seed": 0, "dataset": "data/labyrinth", "revision": None, "fingerprint": "0"}
    loop.save_checkpoint(path, learner(problem_of()), loop.Progress(3), identity)
    moved = identity | {"dataset": "user/labyrinth", "revision": "v1"}
    assert loop.load_checkpoint(path, learner(problem_of()), moved).epoch == 3

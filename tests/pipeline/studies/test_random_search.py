"""Augmented random search climbs, and goes on exactly where it was stopped."""

from __future__ import annotations

import argparse
import importlib.util
import json
import sys
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

SCRIPT = Path(__file__).parents[3] / "scripts/studies/train_experts.py"
SPEC = importlib.util.spec_from_file_location("train_experts", SCRIPT)
script = sys.modules["train_experts"] = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(script)

pytestmark = pytest.mark.slow

SETTINGS = script.Settings(step_size=0.1, directions=8, noise=0.1, top=4)
TARGET = np.array([[1.0, -2.0, 0.5]])


def play(gain, bias, seed):
    """Return how near a policy is to the target, on observations of different scales."""
    observations = np.random.default_rng(seed).normal([5, 0, -1], [2, 0.1, 1], size=(20, 3))
    acted = observations @ gain.T + bias
    wanted = (observations - [5, 0, -1]) / [2, 0.1, 1] @ TARGET.T
    return -float(((acted - wanted) ** 2).sum()), observations


def after(iterations: int, search: script.Search | None = None) -> script.Search:
    search = search or script.Search.start(0, actions=1, observations=3)
    for _ in range(iterations):
        search = script.improve(search, SETTINGS, play)
    return search


def test_it_finds_a_linear_policy_that_is_known():
    search = after(150)
    assert search.weights == pytest.approx(TARGET, abs=0.3)
    start = play(*script.Search.start(0, 1, 3).policy(), 7)[0]
    assert play(*search.policy(), 7)[0] > start / 20


def test_it_normalises_by_the_statistics_of_all_that_was_observed():
    seen = []

    def recorded(gain, bias, seed):
        assert seed >= script.FIRST_SEED
        result = play(gain, bias, seed)
        seen.append(result[1])
        return result

    search = script.Search.start(1, actions=1, observations=3)
    for _ in range(3):
        search = script.improve(search, SETTINGS, recorded)
    everything = np.concatenate(seen)
    assert search.count == len(everything)
    assert search.mean == pytest.approx(everything.mean(axis=0))
    assert search.squares / search.count == pytest.approx(everything.var(axis=0))
    gain, bias = search.policy()
    normalised = (everything[0] - everything.mean(axis=0)) / everything.std(axis=0)
    assert gain @ everything[0] + bias == pytest.approx(search.weights @ normalised)


def test_returns_that_are_all_the_same_move_nothing():
    search = script.improve(
        script.Search.start(0, 1, 3), SETTINGS, lambda *_: (1.0, np.ones((2, 3)))
    )
    assert not search.weights.any()
    assert (search.iteration, search.count) == (1, 32)
    assert not np.isnan(search.policy()[0]).any()


@pytest.mark.skipif(
    find_spec("mujoco") is None, reason="MuJoCo is not there: pip install -e '.[analysis]'"
)
def test_training_that_was_stopped_ends_as_if_it_had_not_been(tmp_path):
    def train(folder: str, iterations: int, **given: float) -> script.Search:
        options = ("step_size", "directions", "noise", "top", "bonus")
        script.train(
            argparse.Namespace(
                environment="Hopper-v5",
                folder=tmp_path / folder,
                seed=0,
                iterations=iterations,
                every=3,
                horizon=50,
                **dict.fromkeys(options) | {"after": 0} | given,
            )
        )
        return script.load(tmp_path / folder / "Hopper-v5-seed0.npz")

    def kept(folder: str) -> dict:
        return json.loads((tmp_path / folder / "Hopper-v5.json").read_text())

    train("stopped", 1)
    stopped, whole = train("stopped", 3), train("whole", 3)
    assert kept("stopped") == kept("whole")
    assert np.array_equal(stopped.weights, whole.weights)
    assert stopped.iteration == 3
    # Settings that are given take effect after so many iterations, and are written down.
    train("stopped again", 1)
    again, once = (train(f, 3, after=1, noise=0.01) for f in ("stopped again", "at once"))
    assert np.array_equal(again.weights, once.weights)
    assert not np.array_equal(once.weights, whole.weights)
    assert "--noise 0.01 --after 1" in kept("at once")["provenance"]["command"]

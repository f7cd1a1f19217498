"""Experts reach the returns that they are kept for."""

from __future__ import annotations

import json

import numpy as np
import pytest
from environments.environment import LABYRINTH, environment_of
from environments.experts import expert_of, source_of
from support.making import RunConfig, resolve

pytestmark = pytest.mark.slow

DATASET = resolve(RunConfig(stages=["build"], data_dir="unused")).dataset


@pytest.mark.parametrize(
    ("name", "seeds", "least", "worst"),
    [("CartPole-v1", 5, 500, 500), ("MountainCar-v0", 60, -110, -125)],
)
def test_experts_are_worth_keeping_and_play_the_same_episode_again(name, seeds, least, worst):
    played = [environment_of(name, DATASET).play(seed) for seed in (1, *range(seeds))]
    returns = [each.total for each in played[1:]]
    assert np.mean(returns) >= least
    assert min(returns) >= worst
    first, again = played[0], played[2]
    assert first.total == again.total
    assert np.array_equal(first.states, again.states)


@pytest.mark.parametrize("name", ["Hopper-v5", "Walker2d-v5", "HalfCheetah-v5"])
def test_a_linear_policy_is_the_one_of_its_file(name):
    kept = json.loads(source_of(name).read_text())
    assert kept["environment"] == name
    gain, bias = np.array(kept["gain"]), np.array(kept["bias"])
    observation = np.random.default_rng(0).normal(size=gain.shape[1])
    assert np.array_equal(expert_of(name)(observation), gain @ observation + bias)


def test_a_seed_gives_the_labyrinth_and_an_optimal_route_of_the_environment():
    import gymnasium

    env = gymnasium.make("labyrinth_core.env:Labyrinth-v0", observation="vector")
    played = environment_of(LABYRINTH, DATASET).play(3)
    observation, info = env.reset(seed=3)
    assert info["distance"] == len(played.actions)
    assert np.array_equal(played.states[0], observation)
    total = 0.0
    for action, state in zip(played.actions, played.states[1:], strict=True):
        observation, reward, terminated, _, _ = env.step(action)
        total += reward
        assert np.array_equal(observation, state)
    assert terminated
    assert total == pytest.approx(played.total)

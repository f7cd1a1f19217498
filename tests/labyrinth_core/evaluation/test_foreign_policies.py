"""Policies in the forms of other libraries: Stable-Baselines3 and LeRobot."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
import torch
from support.policies import Remembering, Rounds, Table, mistaken

from labyrinth_core import Dataset, LabyrinthEnv, PolicyError, evaluate, load_arrays, memorised


@pytest.fixture(scope="module")
def arrays(datasets):
    return load_arrays(datasets, "3x4", "train", image_size=8)


class Predicts:
    """A policy with the `predict` of Stable-Baselines3: it counts its steps, if it remembers."""

    def __init__(self, policy, remembers=False, seen=None):
        self.policy, self.remembers = policy, remembers
        if seen is not None:
            self.observation_space = SimpleNamespace(sample=lambda: seen[0])

    def predict(self, observation, state=None, episode_start=None, deterministic=False):
        assert deterministic
        if not self.remembers:
            return self.policy(observation), state
        if observation.ndim == 3:
            return 0, 1
        assert (state is None) == episode_start.all() == episode_start.any()
        steps = np.zeros(len(observation), int) if state is None else state
        return steps // 3 % 4, steps + 1


class PredictsAsModule(Predicts, torch.nn.Module):
    """As the policies of Stable-Baselines3: what it returns when called are no actions."""

    def __init__(self, *arguments):
        torch.nn.Module.__init__(self)
        super().__init__(*arguments)

    def forward(self, observations):
        return observations, None, None


def test_a_policy_with_the_predict_of_stable_baselines3_is_evaluated(datasets, arrays):
    table, seen = Table(arrays, mistaken(arrays, 0.2)), arrays.observations[~arrays.terminal]
    same = {
        "look-ups": (table, Predicts(table, seen=seen), PredictsAsModule(table, False, seen)),
        "steps": (Remembering(table), Predicts(table)),  # It cannot be asked whether it remembers.
    }
    for way, policies in same.items():
        check_alike(datasets, policies, way)
    check_alike(datasets, [Rounds(3), Predicts(None, True, seen), Predicts(None, True)], "steps")


def check_alike(datasets, policies, way):
    found = [evaluate(each, datasets, "3x4", image_size=8, splits=["train"]) for each in policies]
    assert [each.way for each in found] == [way] * len(found)
    first, *others = (each.splits["train"].figures() for each in found)
    assert all(each == first for each in others)


@pytest.mark.slow  # 4 s: it imports Stable-Baselines3, and trains.
def test_a_model_of_stable_baselines3_is_evaluated_and_asked_whether_it_remembers(datasets):
    import stable_baselines3 as library

    data = Dataset(datasets, "3x4")
    env = LabyrinthEnv(labyrinths=data["train"].labyrinths, observation="vector")
    model = library.PPO("MlpPolicy", env, n_steps=64, seed=0, device="cpu").learn(64)
    results = [evaluate(each, data, observation="vector") for each in (model, model.policy)]
    receipts = [
        memorised(each, data, observation="vector", controls=10) for each in (model, model.policy)
    ]
    assert results[0].way == "look-ups"
    assert receipts[0].everywhere
    assert results[0].splits["test"].figures() == results[1].splits["test"].figures()
    assert receipts[0] == receipts[1]


class Selects(torch.nn.Module):
    """A policy with `reset` and `select_action` of LeRobot."""

    def reset(self):
        pytest.fail("it was asked without its processors")

    def select_action(self, _batch):
        pytest.fail("it was asked without its processors")


def test_a_policy_of_lerobot_is_refused_without_its_processors(datasets):
    message = r"give a LeRobot policy with its processors, as examples/lerobot_policy\.py does"
    with pytest.raises(PolicyError, match=message):
        evaluate(Selects(), datasets, "3x4", image_size=8)

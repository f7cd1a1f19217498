"""What all methods guarantee, each tested on eight labyrinths of 3x3."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest
import torch
from support.learning import equal_weights, learner_of, settings_of, states_seen_by
from torch import nn

from labyrinth_core.evaluation import Player
from labyrinth_core.learning import Learner, Observations, Problem, Steps
from labyrinth_core.pictures import Looks
from pipeline.config import TrainingOptions

pytestmark = pytest.mark.slow

Problems = Callable[..., Problem]

TOYS: dict[str, dict[str, Any]] = {
    "bc": {"epochs": 15, "batch_size": 8, "learning_rate": 2e-3},
    "dagger": {"epochs": 15, "batch_size": 8, "learning_rate": 2e-3, "epochs_a_round": 3},
    "bco": {"epochs": 20, "batch_size": 16, "learning_rate": 2e-3, "epochs_a_round": 5},
    "iupe": {"epochs": 20, "batch_size": 16, "learning_rate": 2e-3, "epochs_a_round": 5},
    "sqil": {"epochs": 20, "batch_size": 64},
    "gail": {"epochs": 35, "batch_size": 32, "learning_rate": 2e-3},
}
"""Method -> settings with which it learns the toy problem in about a second, from vectors."""

OTHERS = ("mapper", "planner")
"""The methods that have tests of their own."""

ALL = pytest.mark.parametrize("name", list(TOYS))


def hasty(name: str, problem: Problem) -> Learner:
    """Return a learner that does in every epoch all that it ever does, but little of it."""
    less = {"epochs_a_round": 1, "model_epochs": 1, "updates": 5, "pictures": 64}
    less |= {"batch_size": 4 if name == "mapper" else 64}
    known = vars(settings_of(name))
    chosen = {key: value for key, value in less.items() if key in known}
    return learner_of(name, problem, **chosen)


def test_each_method_is_tried_here_and_says_what_its_settings_mean() -> None:
    assert {*TrainingOptions.METHODS} == {*TOYS, *OTHERS}
    for name in TrainingOptions.METHODS:
        assert {
            each.name for each in fields(settings_of(name)) if "checks" not in each.metadata
        } == set()


@ALL
def test_the_loss_falls_and_the_policy_beats_chance(name: str, problem_of: Problems) -> None:
    learner = learner_of(name, problem_of(), **TOYS[name])
    arrays = learner.problem.arrays
    losses = [learner.epoch()["loss"] for _ in range(learner.settings.epochs)]
    policy = learner.acting
    if name != "gail":  # The loss of an adversary rises as the policy gets better.
        assert np.mean(losses[-3:]) < np.mean(losses[:3])
    there = arrays.on_demonstration
    actions = policy(arrays.observations).argmax(1)
    right = arrays.optimal[np.arange(len(actions)), actions][there].mean()
    assert right > 2 * arrays.optimal[there].mean()
    assert Player.of(policy).success_rate(arrays) > 0.5


@pytest.mark.parametrize("name", [*TOYS, *OTHERS])
def test_the_same_seed_gives_the_same_weights_and_a_checkpoint_goes_on(
    name: str, problem_of: Problems, require_reproducible: Callable[..., None]
) -> None:
    encoder = "cnn" if name == "planner" else "mlp"
    require_reproducible(lambda seed: hasty(name, problem_of(seed, encoder)))


@pytest.mark.parametrize("name", [*TOYS, *OTHERS])
def test_pictures_that_are_drawn_when_they_are_asked_for_teach_what_held_ones_do(
    name: str, problem_of: Problems
) -> None:
    def trained(held: bool) -> Learner:
        problem = problem_of(encoder="cnn")
        arrays = problem.arrays
        if not held:
            looks = Looks(arrays.spec, arrays.labyrinths, arrays.labyrinth, arrays.state)
            problem = replace(problem, observations=Observations(looks, "cpu"))
        learner = hasty(name, problem)
        for _ in range(2):
            learner.epoch()
        return learner

    held, drawn = trained(True), trained(False)
    assert equal_weights(held.policy.state_dict(), drawn.policy.state_dict())


@ALL
def test_what_acts_and_labels_neither_drops_out_nor_moves_its_statistics(
    name: str, problem_of: Problems
) -> None:
    learner = hasty(name, problem_of(encoder="cnn"))
    modes = []

    def note(module: nn.Module, _: Any) -> None:
        modes.append((torch.is_grad_enabled(), module.training))

    networks = [each for each in vars(learner).values() if isinstance(each, nn.Module)]
    for layer in {layer for network in networks for layer in network.modules()}:
        if isinstance(layer, nn.BatchNorm2d | nn.Dropout):
            layer.register_forward_pre_hook(note)
    for _ in range(2):
        learner.epoch()
    assert (True, True) in modes or name in ("sqil", "gail")
    assert (False, False) in modes or name == "bc"
    assert (False, True) not in modes


@ALL
def test_nothing_is_learnt_in_a_state_that_ends_an_episode(name: str, problem_of: Problems) -> None:
    learner = hasty(name, problem_of())
    assert not learner.problem.arrays.terminal[states_seen_by(learner, epochs=2)].any()


@pytest.mark.parametrize("name", ["bco", "iupe"])
def test_learning_from_observation_never_sees_the_actions(name: str, problem_of: Problems) -> None:
    shown = problem_of().demonstrations
    nonsense = shown._replace(actions=np.full_like(shown.actions, -9))

    def learnt_from(demonstrations: Steps) -> dict[str, torch.Tensor]:
        learner = hasty(name, problem_of(demonstrations=demonstrations))
        for _ in range(3):
            learner.epoch()
        return learner.policy.state_dict()

    assert equal_weights(learnt_from(shown), learnt_from(nonsense))

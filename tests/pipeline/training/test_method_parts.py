"""Details in which implementations of the methods often err: targets, signs, samples, labels."""

from __future__ import annotations

import weakref
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch
from support.learning import learner_of, settings_of, targets_of
from torch import nn

from labyrinth_core.learning import Problem, Rollout, Steps, learner, roll_out
from labyrinth_core.learning.methods import gail, iupe

pytestmark = pytest.mark.slow

Problems = Callable[..., Problem]

PICTURES = torch.randint(0, 256, (3, 64, 64, 3), dtype=torch.uint8)


# Acting.


def test_the_outputs_of_all_states_do_not_keep_those_of_each_batch(
    problem_of: Problems, monkeypatch: pytest.MonkeyPatch
) -> None:
    method = learner_of("bco", problem_of())
    expected = method.outputs(method.policy)
    outputs_of, made = learner.outputs_of, []

    def noted(*arguments: Any) -> torch.Tensor:
        assert sum(each() is not None for each in made) <= 1
        some = outputs_of(*arguments)
        made.append(weakref.ref(some))
        return some

    monkeypatch.setattr(learner, "outputs_of", noted)
    monkeypatch.setattr(learner, "BATCH", 8)
    assert torch.allclose(method.outputs(method.policy), expected)
    assert len(made) > 5


def test_actions_are_drawn_with_their_probabilities(problem_of: Problems) -> None:
    arrays, wanted = problem_of().arrays, np.array([0.1, 0.0, 0.6, 0.3])
    where, taken = arrays.initial.copy(), np.zeros_like(arrays.initial)
    table = np.tile(wanted, (len(arrays.terminal), 1))
    actions = roll_out(arrays, table, where, taken, 2_500, np.random.default_rng(0)).actions.ravel()
    assert np.abs(np.bincount(actions, minlength=4) / actions.size - wanted).max() < 0.015
    assert not (actions == 1).any()


def test_agents_obey_the_labyrinths_and_begin_anew_where_an_episode_is_over(
    problem_of: Problems,
) -> None:
    arrays = problem_of().arrays
    where, taken = arrays.initial.copy(), np.zeros_like(arrays.initial)
    uniform = np.full((len(arrays.observations), 4), 0.25)
    rollout = roll_out(arrays, uniform, where, taken, 400, np.random.default_rng(0))
    assert np.array_equal(rollout.next_states, arrays.next_state[rollout.states, rollout.actions])
    assert np.array_equal(rollout.done, arrays.done[rollout.states, rollout.actions])
    assert rollout.done.any()
    assert (rollout.over & ~rollout.done).sum() == 0  # 360 steps are the limit at 3x3.
    begun = np.where(rollout.over[:-1], arrays.initial, rollout.next_states[:-1])
    assert np.array_equal(rollout.states[1:], begun)
    assert not arrays.terminal[rollout.states].any()


def test_an_episode_is_cut_at_the_step_limit(problem_of: Problems) -> None:
    arrays = problem_of().arrays
    where, taken = arrays.initial.copy(), np.full_like(arrays.initial, arrays.step_limit - 2)
    down = np.tile([0.0, 0.0, 1.0, 0.0], (len(arrays.observations), 1))
    rollout = roll_out(arrays, down, where, taken, 3, np.random.default_rng(0))
    assert rollout.over.all(axis=1).tolist() == [False, True, False]
    assert not rollout.done.any()
    assert set(taken.tolist()) == {1}


# DAgger.


def test_the_expert_labels_exactly_the_states_that_the_policy_visits_with_optimal_actions(
    problem_of: Problems,
) -> None:
    problem = problem_of()
    arrays, learner = problem.arrays, learner_of("dagger", problem)
    actions = learner.outputs(learner.policy).argmax(1).numpy()
    expected = set()
    for state in arrays.initial.tolist():
        while state not in expected and not arrays.terminal[state]:
            expected.add(state)
            state = int(arrays.next_state[state, actions[state]])
    visited = learner.visited()
    assert set(visited.tolist()) == expected
    demonstrated = len(learner.states)
    learner.aggregate(visited)
    new = learner.states[demonstrated:]
    assert set(new.tolist()) == expected - set(problem.demonstrations.states.tolist())
    assert arrays.optimal[new, learner.labels[demonstrated:]].all()
    learner.aggregate(visited)
    assert len(learner.states) == demonstrated + len(new)


# SQIL.


def test_the_goal_is_worth_its_reward_for_ever_and_other_states_the_soft_maximum(
    problem_of: Problems,
) -> None:
    learner = learner_of("sqil", problem_of(), gamma=0.5, temperature=2.0)
    arrays = learner.problem.arrays
    q = torch.tensor([0.0, 1.0, 2.0, 3.0]).expand(len(arrays.observations), 4)
    values = learner.soft_values(q)
    soft = 2 * np.log(np.exp(np.array([0, 1, 2, 3]) / 2).sum())
    assert np.allclose(values[~arrays.terminal], soft)
    assert np.allclose(values[arrays.goal], (1 + 2 * np.log(4)) / (1 - 0.5))


def test_half_a_batch_is_rewarded_with_one_and_half_with_nothing(problem_of: Problems) -> None:
    first = Steps(*(each[:1] for each in problem_of().demonstrations))
    problem = problem_of(demonstrations=first)
    learner = learner_of("sqil", problem, batch_size=10, gamma=0.5)
    learner.own = np.array([[0, 2, 7]])
    learner.values = np.arange(len(learner.values), dtype=np.float64)
    assert targets_of(learner) == [1 + 0.5 * first.next_states[0]] * 5 + [0.5 * 7] * 5


# GAIL.


def test_no_step_is_rewarded_above_zero_and_likelier_ones_more() -> None:
    rewards = gail.reward_of(torch.linspace(-20, 20, 41))
    assert (rewards < 0).all()
    assert (rewards.diff() > 0).all()


def test_advantages_are_the_discounted_sums_that_their_definition_says() -> None:
    rng = np.random.default_rng(0)
    states, after = rng.integers(0, 5, (2, 6, 3))
    actions = rng.integers(0, 4, (6, 3))
    over = rng.random((6, 3)) < 0.3
    done = over & (rng.random((6, 3)) < 0.5)
    outputs, rewards = rng.normal(size=(5, 5)), rng.normal(size=(5, 4))
    settings = settings_of("gail", gamma=0.9, trace=0.8)
    rollout = Rollout(states, actions, after, over, done)
    fatal = done & (rng.random((6, 3)) < 0.5)
    got = gail.sample(rollout, outputs, rewards, fatal, settings).returns.reshape(6, 3)
    for agent in range(3):
        for first in range(6):
            total, weight = outputs[states[first, agent], 4], 1.0
            for step in range(first, 6):
                state, action = states[step, agent], actions[step, agent]
                following = 0 if done[step, agent] else outputs[after[step, agent], 4]
                if fatal[step, agent]:
                    following = rewards[state, action] / (1 - 0.9)
                total += weight * (rewards[state, action] + 0.9 * following - outputs[state, 4])
                weight *= 0.9 * 0.8
                if over[step, agent]:
                    break
            assert np.isclose(got[first, agent], total)


def test_a_gain_is_clipped_and_a_loss_is_not() -> None:
    settings = settings_of("gail", clip=0.2, entropy=0)
    outputs = torch.tensor([[2.0, 0, 0, 0, 0]] * 2)
    actions, advantages = torch.zeros(2, dtype=torch.long), torch.tensor([1.0, -1.0])
    before = torch.log(torch.tensor([0.25, 0.25]))
    losses = gail.policy_loss(settings, outputs, actions, advantages, torch.zeros(2), before)
    ratio = float(outputs[0, :4].softmax(0)[0]) / 0.25
    assert ratio > 1.2
    assert losses.tolist() == pytest.approx([-1.2, ratio])


# BCO.


def test_with_alpha_0_the_model_learns_from_the_random_policy_alone(problem_of: Problems) -> None:
    less = {"epochs_a_round": 1, "model_epochs": 1, "batch_size": 64}
    learner = learner_of("bco", problem_of(), alpha=0, **less)
    for _ in range(2):
        learner.epoch()
    assert np.array_equal(learner.experience, learner.before)


# IUPE.


@pytest.mark.parametrize("reached", [0.0, 0.25, 1.0])
def test_the_models_sample_is_distributed_as_the_paper_asks_for(reached: float) -> None:
    rng = np.random.default_rng(0)
    before = np.zeros((8_000, 3), np.int64)
    before[:, 1] = rng.choice(4, 8_000, p=[0.4, 0.4, 0.1, 0.1])
    # A short episode of ups and a long one of rights count alike.
    steps = np.array([[1, 0, 1]] * 2 + [[1, 1, 1]] * 30)
    episodes = np.array([3] * 2 + [7] * 30)
    if not reached:  # There is no successful episode.
        steps, episodes = steps[:0], episodes[:0]
    composed = iupe.compose(before, steps, episodes, reached, rng)
    assert len(composed) == len(before)
    assert (composed[:, 0] == 1).mean() == reached
    random_share = np.bincount(before[:, 1], minlength=4) / len(before)
    wanted = reached * np.array([0.5, 0.5, 0, 0]) + (1 - reached) * random_share
    assert np.abs(np.bincount(composed[:, 1], minlength=4) / 8_000 - wanted).max() < 0.02


def test_only_whole_episodes_that_reach_the_goal_count_as_successes(problem_of: Problems) -> None:
    problem = problem_of()
    learner = learner_of("iupe", problem, episode_steps=30)
    steps, episodes = learner.successes()
    arrays = problem.arrays
    assert len(steps)
    for episode in set(episodes.tolist()):
        states, _, after = steps[episodes == episode].T
        assert states[0] == arrays.initial[episode]
        assert np.array_equal(states[1:], after[:-1])
        assert arrays.goal[after].tolist() == [False] * (len(after) - 1) + [True]


def test_labels_are_drawn_from_the_models_probabilities(problem_of: Problems) -> None:
    learner = learner_of("iupe", problem_of())
    learner.scores = np.tile(np.log([0.5, 0.5, 1e-9, 1e-9]), (4_000, 1))
    labels = learner.labels()
    assert set(labels.tolist()) == {0, 1}
    assert abs((labels == 0).mean() - 0.5) < 0.03
    assert not np.array_equal(labels, learner.labels())


# What the methods add to the networks of policies.


def parameters(network: nn.Module) -> int:
    return sum(weight.numel() for weight in network.parameters())


def test_the_discriminator_has_the_1028_inputs_of_table_2(problem_of: Problems) -> None:
    learner = learner_of("gail", problem_of(encoder="cnn"))
    discriminator = learner.discriminator
    assert discriminator.classifier[0].in_features == 1028
    assert not [layer for layer in discriminator.modules() if isinstance(layer, nn.BatchNorm2d)]
    convolutions = parameters(learner.policy.encoder) - 2 * 2 * 64
    assert parameters(discriminator) == convolutions + 1028 * 256 + 256 + 256 * 257 + 257
    logits = discriminator(PICTURES)
    assert logits.shape == (3, 4)
    assert len(set(logits.flatten().tolist())) == 12  # It sees state and action.

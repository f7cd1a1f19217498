"""`check_policy` passes what keeps the promises of docs/evaluation.md, and names what does not."""

from __future__ import annotations

import numpy as np
import pytest
from support.policies import Chance, Remembering, Rounds, chance

from labyrinth_core import evaluate
from labyrinth_core.evaluation.replanner import Replanner
from labyrinth_core.testing import check_policy


def right(observations):
    return np.ones(len(observations), np.int64)


def scored(observations):
    return np.tile([0.0, 1.0, 0.0, 0.0], (len(observations), 1))


@pytest.mark.parametrize(
    ("policy", "options"),
    [
        (right, {}),
        (scored, {"height": 3, "width": 4, "task": "icy_floor"}),
        (chance, {}),
        (Chance(), {}),
        (Rounds(2), {}),
        (Remembering(right), {"observation": "text"}),
        (Replanner(3, 3), {"task": "partial_observability"}),
    ],
)
def test_policies_that_keep_their_promises_pass(policy, options):
    check_policy(policy, **options)


class Numbered(Rounds):
    """A policy with memory that is told which episodes go on."""

    def act(self, observations, episodes):
        assert len(observations) == len(episodes)
        self.asked = len(episodes)
        self.steps[episodes] += 1
        return (self.steps[episodes] - 1) // self.turns % 4


def test_a_policy_that_takes_the_numbers_of_episodes_sees_only_those_that_go_on(small_dataset):
    check_policy(Numbered(2))
    policy = Numbered(2)
    found, usual = (
        evaluate(each, small_dataset.data_dir, "3x3", splits=["test"]).splits["test"].episodes
        for each in (policy, Rounds(2))
    )
    assert found.letters == usual.letters
    assert found.moves.tolist() == usual.moves.tolist()
    assert policy.asked == (~found.solved).sum()  # In the last step.


def alone(observations):
    return np.full(len(observations), len(observations) % 3)


def fickle(observations, state=np.random.default_rng(0)):  # noqa: B008
    return state.integers(4, size=len(observations))


def blunt(observations):
    observations[:] = 0
    return right(observations)


def single(observations):
    return right(observations)[:8]


class Forgetless(Rounds):
    """Goes on counting in the next episodes."""

    def reset(self, count):
        old = getattr(self, "steps", np.zeros(1, np.int64)).max()
        self.steps = np.full(count, old % 7)


class Leaning(Rounds):
    """Does what the number of episodes says."""

    def act(self, observations):
        return np.full(len(observations), len(observations) % 4)


class Vague(Rounds):
    def remembered(self):
        return np.zeros(3)


class Large:
    observation, image_size = "image", 10_000

    def __call__(self, observations):
        return right(observations)


@pytest.mark.parametrize(
    ("policy", "sentence"),
    [
        (7, "A policy is a function, a PyTorch module, or has reset and act, or predict"),
        (Large(), "A policy can be shown labyrinths of the size and task"),
        (single, "A function answers B observations with B actions"),
        (lambda seen: np.full(len(seen), 9), "A function answers B observations with B actions"),
        (alone, "A function answers each observation by itself"),
        (fickle, "A function answers each observation by itself"),
        (blunt, "A policy does not change the observations"),
        (Forgetless(2), r"reset\(count\) forgets all earlier episodes"),
        (Leaning(2), "What happens in an episode does not depend on the episodes beside it"),
        (Vague(2), r"remembered\(\) returns an array"),
    ],
)
def test_a_broken_promise_is_named(policy, sentence):
    with pytest.raises(AssertionError, match=rf"\A{sentence}"):
        check_policy(policy)

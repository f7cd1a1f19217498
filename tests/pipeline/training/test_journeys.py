"""Journeys are the episodes that a policy would have anywhere."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.evaluation.following import follow, greedy_actions
from labyrinth_core.evaluation.journeys import travel
from pipeline.training.methods.method import Problem


class Arbitrary:
    """A policy that does something or other, always the same in the same picture."""

    def logits(self, observations: NDArray[np.uint8]) -> NDArray[np.float32]:
        sums = observations.astype(np.int64).reshape(len(observations), 4, -1).sum(axis=2)
        return (sums % 101).astype(np.float32)


def test_a_journey_goes_as_the_look_ups_say(problem_of: Callable[..., Problem]) -> None:
    arrays = problem_of(encoder="cnn").arrays
    policy = Arbitrary()
    episodes = follow(arrays, greedy_actions(policy, arrays))
    journeys = travel(policy, arrays.labyrinths, 64)
    assert [journey.solved for journey in journeys] == episodes.solved.tolist()
    for journey, labyrinth in zip(journeys, arrays.labyrinths, strict=True):
        assert journey.states[0].agent == labyrinth.start
        assert len(set(journey.states)) >= len(journey.states) - 1

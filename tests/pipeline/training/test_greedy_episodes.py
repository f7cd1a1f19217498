"""Greedy episodes state by state are those of the look-ups."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from labyrinth_core.evaluation.following import follow, greedy_actions, greedy_episodes
from pipeline.training.methods.method import Problem

pytestmark = pytest.mark.slow


class Arbitrary:
    """A policy that does something or other, always the same in the same picture."""

    def __call__(self, observations: NDArray[np.uint8]) -> NDArray[np.float32]:
        sums = observations.astype(np.int64).reshape(len(observations), 4, -1).sum(axis=2)
        return (sums % 101).astype(np.float32)


def test_a_greedy_episode_goes_as_the_look_ups_say(problem_of: Callable[..., Problem]) -> None:
    arrays = problem_of(encoder="cnn").arrays
    policy = Arbitrary()
    expected = follow(arrays, greedy_actions(policy, arrays))
    episodes = greedy_episodes(policy, arrays.labyrinths, 64)
    assert [episode.solved for episode in episodes] == expected.solved.tolist()
    for episode, labyrinth in zip(episodes, arrays.labyrinths, strict=True):
        assert episode.states[0].agent == labyrinth.start
        assert len(set(episode.states)) >= len(episode.states) - 1

"""Episodes of a policy step by step are those that it is judged by, cut earlier."""

from __future__ import annotations

import numpy as np
import pytest
from labyrinths_of_datasets import CONFIGS
from policies import Remembering, Rounds, Table

from labyrinth_core import load_arrays
from labyrinth_core.evaluation.answers import Player
from labyrinth_core.evaluation.playing import attempts, step_through


@pytest.mark.parametrize("config", CONFIGS.values())
def test_an_attempt_takes_the_steps_of_the_episode_that_is_judged(datasets, config):
    arrays = load_arrays(datasets, config, "test", observation="vector")
    random = Table(arrays, np.random.default_rng(0).integers(4, size=len(arrays.terminal)))
    optimal = Table(arrays, arrays.optimal.argmax(axis=1))
    for policy in (random, optimal, Remembering(random), Rounds(2)):
        player = Player.of(policy, 0)
        judged = step_through(player, arrays, 1)
        tried = attempts(player, arrays, range(len(arrays.labyrinths)))
        for place, episode in enumerate(tried):
            moves, outcome = judged.moves[0, place], judged.outcomes[0, place]
            assert len(episode) == min(moves, arrays.cells)
            if moves <= arrays.cells:
                reached = episode.states[-1].agent == episode.labyrinth.goal
                assert reached == (outcome == "solved")
            if policy is optimal:
                assert len(episode) == arrays.distance[place]

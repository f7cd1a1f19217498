"""What remembers train, recomputed from the episodes of train without its code."""

from __future__ import annotations

from collections import Counter, defaultdict

import numpy as np
import pytest
from support.labyrinths_of_datasets import CONFIGS
from support.policies import Table

from labyrinth_core import load_arrays, load_episodes
from labyrinth_core.data import SPLITS
from labyrinth_core.evaluation import Player
from labyrinth_core.evaluation.baselines import TrainMemory
from labyrinth_core.language import parse
from labyrinth_core.world import Solver


def visited(labyrinth, actions):
    return [state.agent for state in labyrinth.replay(actions).states]


def parts(cells):
    places = range(len(cells))
    return {tuple(cells[a : b + 1]) for a in places for b in places if a < b}


@pytest.mark.slow
@pytest.mark.parametrize("config", CONFIGS.values())
@pytest.mark.parametrize("split", SPLITS.evaluated)
def test_a_route_is_known_where_a_shortest_one_is_part_of_a_demonstrated_one(
    datasets, config, split
):
    train, arrays = (
        load_arrays(datasets, config, name, observation="vector") for name in ("train", split)
    )
    known = set()
    for episode in load_episodes(datasets, config, split="train", observation="vector"):
        known |= parts(visited(parse(episode.info), episode.actions.tolist()))
    expected = [
        any(
            tuple(visited(labyrinth, route)) in known
            for route in Solver(labyrinth).shortest_routes()
        )
        for labyrinth in arrays.labyrinths
    ]
    memory = TrainMemory.of(train)
    found, figures = memory.figures(arrays)
    assert found.tolist() == expected
    assert figures["route_memory"]["sr"] >= np.mean(expected)
    if split == "train":
        assert all(expected)
        assert figures["route_memory"]["spl"] == 1


@pytest.mark.parametrize("split", ["train", "test"])
def test_local_walls_are_looked_up_in_the_same_cell_then_anywhere(datasets, split):
    train, arrays = (
        load_arrays(datasets, "3x4", name, observation="vector") for name in ("train", split)
    )

    def keys(of, state):
        walls = tuple((of.next_state[state] == state).tolist())
        return (int(of.position[state]), walls), walls, ()

    counts = defaultdict(Counter)
    for state, taken in enumerate(train.demonstrated.tolist()):
        for key in keys(train, state):
            counts[key].update(dict(enumerate(taken)))
    expected = []
    for state in range(len(arrays.position)):
        met = next(counts[key] for key in keys(arrays, state) if counts[key].total())
        expected.append(min(met, key=lambda action: (-met[action], action)))
    looked_up = Player.of(Table(arrays, np.array(expected))).score(arrays)
    _, figures = TrainMemory.of(train).figures(arrays)
    assert figures["local_walls"] == looked_up.summary()

"""What remembers train, recomputed from the episodes of train without its code."""

from __future__ import annotations

import numpy as np
import pytest
from support.labyrinths_of_datasets import CONFIGS
from support.policies import Table
from support.remembering import known_routes, local_walls

from labyrinth_core import load_arrays, load_episodes
from labyrinth_core.data import SPLITS
from labyrinth_core.evaluation import KnownDataset, Player


@pytest.mark.slow
@pytest.mark.parametrize("config", CONFIGS.values())
@pytest.mark.parametrize("split", SPLITS.evaluated)
def test_a_route_is_known_where_a_shortest_one_is_part_of_a_demonstrated_one(
    datasets, config, split
):
    arrays = load_arrays(datasets, config, split, observation="vector")
    train = load_episodes(datasets, config, split="train", observation="vector")
    expected = known_routes(train, arrays.labyrinths)
    found = KnownDataset.read(str(datasets), config).split(split)
    assert found.known_route.tolist() == expected
    assert found.baselines["route_memory"]["sr"] >= np.mean(expected)
    if split == "train":
        assert all(expected)
        assert found.baselines["route_memory"]["spl"] == 1


@pytest.mark.parametrize("split", ["train", "test"])
def test_local_walls_are_looked_up_in_the_same_cell_then_anywhere(datasets, split):
    train, arrays = (
        load_arrays(datasets, "3x4", name, observation="vector") for name in ("train", split)
    )
    looked_up = Player.of(Table(arrays, local_walls(train, arrays))).score(arrays)
    found = KnownDataset.read(str(datasets), "3x4").split(split)
    assert found.baselines["local_walls"] == looked_up.summary()

"""The episodes of each labyrinth, from the routes through it or from a random policy."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import NamedTuple

import numpy as np

from labyrinth_core.data.dataset_config import DatasetConfig
from labyrinth_core.data.splits import SPLITS
from labyrinth_core.world.dynamics import Episode, random_episode, replay
from labyrinth_core.world.labyrinth import Labyrinth
from labyrinth_core.world.solver import (
    erring_route,
    moves_and_routes,
    shortest_route,
    shortest_routes,
    simple_routes,
)
from pipeline.generation.variants import ACTING, item_rng


class Solution(NamedTuple):
    """The episodes of one labyrinth, at least one."""

    episodes: list[Episode]
    shortest: tuple[int, int]
    """How many moves a shortest route has, and how many such routes there are."""

    @property
    def labyrinth(self) -> Labyrinth:
        """The labyrinth, which all episodes share."""
        return self.episodes[0].labyrinth


def solve(config: DatasetConfig, split: str, labyrinth: Labyrinth) -> Solution:
    """Return the episodes of a labyrinth, in order.

    Args:
        config: The configuration, which says which routes are asked for.
        split: The split of the labyrinth; in `random` a random policy acts instead.
        labyrinth: The labyrinth to solve.
    """
    make_rng = partial(acting_rng, config, split, labyrinth)
    if split == "random":
        episodes = list(_random_episodes(labyrinth, make_rng(), config.random_steps))
    elif config.noise:
        episodes = [replay(labyrinth, erring_route(labyrinth, config.noise, make_rng()))]
    elif config.solutions == "shortest":
        episodes = [replay(labyrinth, shortest_route(labyrinth, make_rng))]
    else:
        episodes = [replay(labyrinth, route) for route in all_routes(config, labyrinth)]
    return Solution(episodes, moves_and_routes(labyrinth))


def acting_rng(config: DatasetConfig, split: str, labyrinth: Labyrinth) -> np.random.Generator:
    """Return the randomness of what is demonstrated in a labyrinth of a split.

    Where a shift changes only pictures, it is that of its parent.
    """
    drawn_for = SPLITS[split].parent if SPLITS[split].is_redrawn else None
    return item_rng(config, drawn_for or split, labyrinth.structure, ACTING)


def all_routes(config: DatasetConfig, labyrinth: Labyrinth) -> list[list[int]]:
    """Return the routes of a labyrinth, as actions, where `solutions` asks for more than one."""
    enumerate_routes = shortest_routes if config.solutions == "all_shortest" else simple_routes
    return enumerate_routes(labyrinth, config.solutions_limit)


def _random_episodes(
    labyrinth: Labyrinth, rng: np.random.Generator, steps: int
) -> Iterator[Episode]:
    """Yield episodes of a random policy that have `steps` steps in total, the last one cut."""
    while steps:
        episode = random_episode(labyrinth, rng, steps)
        steps -= len(episode)
        yield episode

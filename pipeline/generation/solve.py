"""The episodes of each labyrinth: optimal routes, or a random policy."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import NamedTuple

import numpy as np

from labyrinth_core.data.dataset_config import DatasetConfig
from labyrinth_core.world.labyrinth import Labyrinth
from labyrinth_core.world.rollout import Episode, random_episode, replay
from labyrinth_core.world.solver import shortest_route, shortest_routes, simple_routes


class Solution(NamedTuple):
    """The episodes of one labyrinth."""

    labyrinth: Labyrinth
    episodes: list[Episode]
    cut: bool
    """Whether `solutions_limit` may have left routes out."""


def solve(
    config: DatasetConfig,
    split: str,
    labyrinths: Iterable[tuple[Labyrinth, Callable[[], np.random.Generator]]],
) -> Iterator[Solution]:
    """Yield the episodes of each labyrinth, in order.

    Args:
        config: Says which routes.
        split: In `random` a random policy acts instead.
        labyrinths: Each with what makes the randomness for its episodes.
    """
    for labyrinth, make_rng in labyrinths:
        if split == "random":
            episodes = list(_random_episodes(labyrinth, make_rng(), config))
            yield Solution(labyrinth, episodes, cut=False)
            continue
        routes = _routes(config, labyrinth, make_rng)
        cut = config.solutions != "shortest" and len(routes) == config.solutions_limit
        yield Solution(labyrinth, [replay(labyrinth, route) for route in routes], cut)


def _routes(
    config: DatasetConfig, labyrinth: Labyrinth, make_rng: Callable[[], np.random.Generator]
) -> list[list[int]]:
    if config.solutions == "shortest":
        return [shortest_route(labyrinth, make_rng)]
    if config.solutions == "all_shortest":
        return shortest_routes(labyrinth, config.solutions_limit)
    return simple_routes(labyrinth, config.solutions_limit)


def _random_episodes(
    labyrinth: Labyrinth, rng: np.random.Generator, config: DatasetConfig
) -> Iterator[Episode]:
    """Yield episodes that take `random_steps` steps together, the last one cut there."""
    left = config.random_steps
    while left:
        episode = random_episode(labyrinth, rng, left)
        left -= len(episode)
        yield episode

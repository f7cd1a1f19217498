"""What train demonstrates, counted without the library's code: routes, and walls of cells."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.evaluation import LabyrinthArrays
from labyrinth_core.language import parse
from labyrinth_core.world import Labyrinth, Solver


def _visited(labyrinth: Labyrinth, actions: Iterable[int]) -> list[int]:
    return [state.agent for state in labyrinth.replay(actions).states]


def known_routes(episodes: Iterable[Any], labyrinths: Iterable[Labyrinth]) -> list[bool]:
    """Return whether a shortest route of each labyrinth is part of one of the episodes."""
    known = set()
    for episode in episodes:
        cells = _visited(parse(episode.info), episode.actions.tolist())
        places = range(len(cells))
        known |= {tuple(cells[a : b + 1]) for a in places for b in places if a < b}
    return [
        any(tuple(_visited(each, route)) in known for route in Solver(each).shortest_routes())
        for each in labyrinths
    ]


def local_walls(train: LabyrinthArrays, arrays: LabyrinthArrays) -> NDArray[np.int64]:
    """Return what train does most often in the same cell with the same walls, then anywhere."""

    def keys(of, state):
        walls = tuple((of.next_state[state] == state).tolist())
        return (int(of.position[state]), walls), walls, ()

    counts = defaultdict(Counter)
    for state, taken in enumerate(train.demonstrated.tolist()):
        for key in keys(train, state):
            counts[key].update(dict(enumerate(taken)))
    actions = []
    for state in range(len(arrays.position)):
        met = next(counts[key] for key in keys(arrays, state) if counts[key].total())
        actions.append(min(met, key=lambda action: (-met[action], action)))
    return np.array(actions)

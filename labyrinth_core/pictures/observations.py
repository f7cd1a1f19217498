"""How an agent can observe a state, besides as a picture.

Loading, evaluation and environments read `KINDS`, so a kind is declared here alone.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.language.drawing import describe
from labyrinth_core.pictures.vector import (
    GONE,
    WALL,
    tile_count,
    vector_observation,
    vector_observations,
)
from labyrinth_core.world.batch import Labyrinths
from labyrinth_core.world.labyrinth import Labyrinth
from labyrinth_core.world.rules import State, Task

Numbers = NDArray[np.int64]


class Kind(NamedTuple):
    """A kind of observation that is a function of the state alone."""

    of: Callable[[Labyrinth, State], Any]
    """Returns the observation of a state."""
    of_many: Callable[[Labyrinths, Numbers, Numbers], NDArray[Any]] | None = None
    """Returns the same for N states, faster, given labyrinths, the index of each state's labyrinth
    and the index of each state; None makes them one by one."""
    bounds: Callable[[int, int, Task], tuple[NDArray[Any], NDArray[Any]]] | None = None
    """Returns the least and the greatest value of each entry, given height, width and task; None if
    environments do not offer this kind."""


def _vector_bounds(
    height: int, width: int, task: Task
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    entries, tiles = (2 * height - 1) * (2 * width - 1), tile_count(task)
    high = np.full(tiles + entries, WALL + len(task.rules.grounds), np.int32)
    high[:tiles] = entries - 1
    low = np.zeros_like(high)
    low[3:tiles] = GONE
    return low, high


KINDS = {
    "vector": Kind(vector_observation, vector_observations, _vector_bounds),
    "text": Kind(describe),
}
"""Name -> kind. Pictures, which also depend on options, are drawn by `scenes`."""

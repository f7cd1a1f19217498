"""Observations: a picture of a state, its vector form, or its number."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any, Literal, cast, get_args

import numpy as np
from gymnasium.spaces import Box, Discrete, Space
from numpy.typing import NDArray

from labyrinth_core.env.labyrinth_source import chosen
from labyrinth_core.pictures.png import PICTURE_SIZE
from labyrinth_core.pictures.renderer import render
from labyrinth_core.pictures.vector import GONE, ICE, WALL, tile_count, vector_observation
from labyrinth_core.world.dynamics import state_at
from labyrinth_core.world.labyrinth import Labyrinth, Task

Kind = Literal["image", "vector", "state"]
Array = NDArray[np.uint8] | NDArray[np.int32]
Observation = Array | np.int64
DEFAULT_IMAGE_SIZE = 64
"""Pixels on each side of the baselines' pictures (supplement, section 4)."""
CACHE_BYTES = 16 * 1024 * 1024
"""Memory for pictures and vectors that may be observed again."""


class Observer:
    """Turns states into observations of one kind, each an array of its own.

    The cache holds at least two observations of each environment.

    Raises:
        ValueError: There is no such kind, or no picture of such a size.
    """

    def __init__(self, kind: Kind, image_size: int, environments: int = 1) -> None:
        chosen("observation", kind, get_args(Kind))
        if image_size not in range(1, PICTURE_SIZE + 1):
            raise ValueError(
                f"image_size={image_size}: give a whole number of pixels from 1 to {PICTURE_SIZE}"
            )
        self.kind = kind
        self._image_size = int(image_size)
        self._environments = environments
        self._cached: Callable[[Labyrinth, int], Array] | None = None

    def __getstate__(self) -> dict[str, Any]:
        return vars(self) | {"_cached": None}  # A cache cannot be pickled, and fills up again.

    def space(self, height: int, width: int, task: Task) -> Space[Any]:
        """Return the space of the observations of labyrinths of a size and task.

        - `image`: `Box(0, 255, (image_size, image_size, 3), uint8)`, rows from the top.
        - `vector`: `Box`, int32, as `vector.vector_observation` has it, with bounds for each entry.
        - `state`: `Discrete(states)`, the number that `dynamics.state_index` gives a state.
        """
        if self.kind == "image":
            return Box(0, 255, (self._image_size, self._image_size, 3), np.uint8)
        if self.kind == "state":
            return Discrete(height * width * (3 if task is Task.KEY_AND_DOOR else 1))
        entries, tiles = (2 * height - 1) * (2 * width - 1), tile_count(task)
        high = np.full(tiles + entries, ICE if task is Task.ICY_FLOOR else WALL, np.int32)
        high[:tiles] = entries - 1
        low = np.zeros_like(high)
        low[3:tiles] = GONE
        return Box(low, high, dtype=np.int32)

    def observe(self, labyrinth: Labyrinth, state: int) -> Observation:
        """Return the observation of the state with a number."""
        if self.kind == "state":
            number: np.int64 = np.int64(state)
            return number
        if self._cached is None:
            size: int = self._draw(labyrinth, state).nbytes
            self._cached = lru_cache(max(CACHE_BYTES // size, 2 * self._environments))(self._draw)
        return cast("Array", self._cached(labyrinth, state).copy())

    def _draw(self, labyrinth: Labyrinth, number: int) -> Array:
        state = state_at(labyrinth, number)
        if self.kind == "image":
            return render(labyrinth, state, self._image_size)
        return vector_observation(labyrinth, state)

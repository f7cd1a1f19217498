"""Observations of a state: its image, its vector, or its index."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Any

import numpy as np
from gymnasium.spaces import Box, Discrete, Space
from numpy.typing import NDArray

from labyrinth_core.env.labyrinth_source import chosen
from labyrinth_core.pictures import OBSERVATIONS, ObservationSpec
from labyrinth_core.world import Labyrinth, Task

Kind = str
"""One of `PLAYED`."""
PLAYED = (*(name for name in OBSERVATIONS if ObservationSpec(name).is_bounded), "state")
"""The observations of environments; `state` is the index of the state."""
Array = NDArray[np.uint8] | NDArray[np.int32]
Observation = Array | np.int64
CACHE_BYTES = 16 * 1024 * 1024
"""The memory of an observer's cache of pictures and vectors."""
TOGETHER, TOGETHER_BYTES = 32, 2**21
"""How many consecutive states are drawn together, and the most bytes of their pictures."""


class Observer:
    """Turns states into observations of one kind, each a new array.

    Raises:
        ValueError: The kind or the image size is not allowed.
    """

    def __init__(self, kind: Kind, image_size: int) -> None:
        chosen("observation", kind, PLAYED)
        self.kind = kind
        shown = "image" if kind == "state" else kind
        self._spec = ObservationSpec(shown, image_size)
        self.image_size = self._spec.image_size
        self._together = 1
        if kind == "image":
            self._together = max(1, min(TOGETHER, TOGETHER_BYTES // (3 * self.image_size**2)))
        self._cached: Callable[[Labyrinth, int], Array] | None = None
        self._latest: tuple[Labyrinth | None, int, Any] = None, 0, None
        """The latest labyrinth, the index of a block of its states, and their observations."""

    def __getstate__(self) -> dict[str, Any]:
        # The cache cannot be pickled; it refills.
        return vars(self) | {"_cached": None, "_latest": (None, 0, None)}

    def space(self, height: int, width: int, task: Task) -> Space[Any]:
        """Return the observation space for labyrinths of a size and task.

        - `image`: `Box(0, 255, (image_size, image_size, 3), uint8)`, rows from the top.
        - `vector`, and the other kinds of `observations.KINDS`: `Box`, with bounds for each entry.
        - `state`: `Discrete(states)`, the index that `Labyrinth.state_index` gives a state.
        """
        if self.kind == "state":
            return Discrete(height * width * task.rules.phases)
        low, high = self._spec.bounds(height, width, task)
        return Box(low, high, dtype=low.dtype.type)

    def observe(self, labyrinth: Labyrinth, state: int) -> Observation:
        """Return the observation of the state with the given index."""
        if self.kind == "state":
            number: np.int64 = np.int64(state)
            return number
        if self._cached is None:
            size: int = self._draw(labyrinth, 0).nbytes
            self._cached = lru_cache(max(CACHE_BYTES // size, 2))(self._draw)
        block, place = divmod(state, self._together)
        if labyrinth is not self._latest[0] or block != self._latest[1]:  # Hashing takes longer.
            self._latest = labyrinth, block, self._cached(labyrinth, block)
        observation: Array = self._latest[2][place].copy()
        return observation

    def _draw(self, labyrinth: Labyrinth, block: int) -> Array:
        first = block * self._together
        end = min(first + self._together, labyrinth.state_count)
        drawn: Array = self.batch([(labyrinth, state) for state in range(first, end)])
        return drawn

    def batch(self, shown: Sequence[tuple[Labyrinth, int]]) -> NDArray[Any]:
        """Return the observations of N pairs of a labyrinth and a state index, as N rows."""
        if self.kind == "state":
            return np.array([number for _, number in shown])
        views = [(labyrinth, labyrinth.state_at(number)) for labyrinth, number in shown]
        return self._spec.look(views)

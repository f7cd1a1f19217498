"""What an environment shows of a state: a picture, a vector, or the number of the state."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Literal, cast, get_args

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.pictures.png import PICTURE_SIZE
from labyrinth_core.pictures.renderer import render
from labyrinth_core.pictures.vector import vector_observation
from labyrinth_core.world.dynamics import State, state_at
from labyrinth_core.world.labyrinth import Labyrinth

Kind = Literal["image", "vector", "state"]
Array = NDArray[np.uint8] | NDArray[np.int32]
Observation = Array | np.int64
DEFAULT_IMAGE_SIZE = 64
"""Pixels on each side of what the baselines look at (supplement, section 4)."""
CACHE_BYTES = 16 * 1024 * 1024
"""Memory for pictures and vectors that are kept because they may be asked for again."""


class Observer:
    """Turns states into observations of one kind, each an array of its own."""

    def __init__(self, kind: Kind, image_size: int, environments: int = 1) -> None:
        """Settle the kind.

        Args:
            kind: What to show.
            image_size: Pixels on each side of a picture.
            environments: How many there are to show; what each showed last is kept at least.

        Raises:
            ValueError: There is no such kind, or no picture of such a size.
        """
        if kind not in get_args(Kind):
            raise ValueError(f"observation={kind}: choose one of {', '.join(get_args(Kind))}")
        if image_size not in range(1, PICTURE_SIZE + 1):
            raise ValueError(
                f"image_size={image_size}: give a whole number of pixels from 1 to {PICTURE_SIZE}"
            )
        self.kind = kind
        self.image_size = int(image_size)
        self._environments = environments
        self._kept: Callable[[Labyrinth, int], Array] | None = None

    def observe(self, labyrinth: Labyrinth, state: int) -> Observation:
        """Return the observation of the state with a number."""
        if self.kind == "state":
            number: np.int64 = np.int64(state)
            return number
        if self._kept is None:
            self._kept = self._keep(labyrinth)
        return cast("Array", self._kept(labyrinth, state).copy())

    def _keep(self, labyrinth: Labyrinth) -> Callable[[Labyrinth, int], Array]:
        """Return the function that looks, with a memory of what it saw."""
        size: int = self._look(labyrinth, labyrinth.start).nbytes
        most = max(CACHE_BYTES // size, 2 * self._environments)
        kept: Callable[[Labyrinth, int], Array] = lru_cache(most)(self._look)
        return kept

    def _look(self, labyrinth: Labyrinth, state: int) -> Array:
        at: State = state_at(labyrinth, state)
        if self.kind == "image":
            return render(labyrinth, at, self.image_size)
        return vector_observation(labyrinth, at)

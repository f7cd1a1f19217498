"""Observations of many states, which are made when they are indexed, or held."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.pictures.observations import RESIZES, ObservationSpec
from labyrinth_core.pictures.scenes import DRAWN_CELLS, KeptScenes
from labyrinth_core.world import Labyrinth, Labyrinths, Look

HELD_BYTES = 2**30
"""Above this many bytes, observations of all states are not held, but made when indexed."""

KEPT_BYTES = 2**28
"""Above this many bytes, the scenes of pictures that are drawn when indexed are not kept either."""


class Looks:
    """Observations of states, made from the labyrinths each time they are indexed."""

    def __init__(
        self,
        spec: ObservationSpec,
        labyrinths: Sequence[Labyrinth],
        which: NDArray[np.int64],
        states: NDArray[np.int64],
    ) -> None:
        """Collect the labyrinths of each look, which are drawn together.

        Args:
            spec: How the states are observed.
            labyrinths: One or more labyrinths of one size and task.
            which: The index of each state's labyrinth, shape (S,).
            states: The index of each state in it, as in `Labyrinth.state_index`, shape (S,).
        """
        self._spec, self._labyrinths = spec, labyrinths
        self._which, self._states = which, states
        self._scenes: dict[int, KeptScenes] = {}
        looks: dict[Look, list[int]] = {}
        for number, each in enumerate(labyrinths if spec.of_arrays else []):
            looks.setdefault(each.look, []).append(number)
        self._group, self._offset = np.zeros((2, len(labyrinths)), np.int64)
        for group, numbers in enumerate(looks.values()):
            self._group[numbers], self._offset[numbers] = group, range(len(numbers))
        self._alike = [
            Labyrinths.of([labyrinths[number] for number in numbers]) for numbers in looks.values()
        ]

    def __len__(self) -> int:
        """Return the number of states."""
        return len(self._states)

    def __getitem__(self, chosen: NDArray[np.int64]) -> NDArray[Any]:
        """Return the observations of N states, shape (N, ...)."""
        which, states = self._which[chosen], self._states[chosen]
        if not self._alike:
            pairs = zip(which.tolist(), states.tolist(), strict=True)
            parsed = self._labyrinths
            return self._spec.look([(parsed[n], parsed[n].state_at(state)) for n, state in pairs])
        group, offset = self._group[which], self._offset[which]
        parts = []
        for number, alike in enumerate(self._alike):
            rows = np.flatnonzero(group == number)
            if self._keeps:
                seen = self._kept(number).draw(offset[rows], states[rows])
            else:
                # Only the labyrinths that are shown: drawing takes time for each that it is given.
                used, own = np.unique(offset[rows], return_inverse=True)
                seen = self._spec.look_together(alike.take(used), own, states[rows])
            parts.append((rows, seen))
        if len(parts) == 1:
            return seen
        observations = np.empty((len(states), *seen.shape[1:]), seen.dtype)
        for rows, seen in parts:
            observations[rows] = seen
        return observations

    @cached_property
    def _keeps(self) -> bool:
        """Whether the scenes of all labyrinths are kept once they are drawn."""
        task = self._alike[0].task
        if self._spec.observation != "image" or task.rules.hides:
            return False
        wall_pixels, resize = RESIZES[self._spec.resize]
        needed = sum(
            KeptScenes.memory_of(
                alike, self._spec.image_size, wall_pixels=wall_pixels, resize=resize
            )
            for alike in self._alike
        )
        return needed <= KEPT_BYTES

    def _kept(self, number: int) -> KeptScenes:
        """Return the scenes of the labyrinths of a look, which are drawn when first requested."""
        if number not in self._scenes:
            wall_pixels, resize = RESIZES[self._spec.resize]
            self._scenes[number] = KeptScenes(
                self._alike[number],
                self._spec.image_size,
                wall_pixels=wall_pixels,
                resize=resize,
            )
        return self._scenes[number]

    def held(self) -> NDArray[Any] | Looks:
        """Return all observations as an array, or this object if they exceed `HELD_BYTES`."""
        count, numbers = len(self), np.arange(len(self))
        if count * self[numbers[:1]].nbytes > HELD_BYTES:
            return self
        if not self._alike:
            return self[numbers]
        cells = self._alike[0].ground.shape[1]
        together = max(1, min(self._spec.together, DRAWN_CELLS // cells))
        first = self[numbers[:together]]
        observations = np.empty((count, *first.shape[1:]), first.dtype)
        for begin in range(0, count, together):
            observations[begin : begin + together] = self[numbers[begin : begin + together]]
        return observations

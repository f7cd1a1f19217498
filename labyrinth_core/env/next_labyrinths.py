"""Sample the next labyrinths of hundreds of sub-environments together.

Sampling them one at a time takes ten times as long. Each labyrinth still comes from the generator
of its sub-environment, and is the one that a single environment would draw.
"""

from __future__ import annotations

from collections.abc import Callable
from math import isqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.env.labyrinth_source import Shape
from labyrinth_core.env.stack import Stack
from labyrinth_core.world import BatchSampler, Tables

FEWEST = 128
"""The fewest sub-environments for which sampling together is faster."""


class NextLabyrinths:
    """Holds up to one fresh labyrinth per sub-environment, all of one size, without tiles."""

    def __init__(self, count: int, shape: Shape, *, normalised: bool) -> None:
        """Make room for the labyrinths of `count` sub-environments.

        Args:
            count: The number of sub-environments.
            shape: Size and task of all labyrinths.
            normalised: As in `Tables.of`.
        """
        self._normalised = normalised
        self._sampler = BatchSampler(shape.height, shape.width)
        self._stack = Stack(count, *shape)
        self._there = np.zeros(count, np.bool_)
        self._left_out = np.zeros(count, np.bool_)
        """Whether this labyrinth cannot be batched and is sampled alone."""
        self._before: list[Any] = [None] * count
        """The state of each generator before its labyrinth was drawn."""
        self._enough = 8 * isqrt(count)

    @staticmethod
    def pay(count: int, shape: Shape) -> bool:
        """Return whether `count` labyrinths of a shape can be sampled together, and faster."""
        return (
            not shape.task.rules.tiles
            and count >= FEWEST
            and shape.height * shape.width <= BatchSampler.MOST_CELLS
        )

    def load(
        self,
        stack: Stack,
        places: NDArray[np.int64],
        generator: Callable[[int], np.random.Generator],
    ) -> NDArray[np.int64]:
        """Load the next labyrinths into some places of a stack.

        Args:
            stack: The stack of the sub-environments.
            places: The sub-environments that begin an episode.
            generator: Returns the generator of a sub-environment.

        Returns:
            The places left without a labyrinth; their generators are ready to draw it.
        """
        if not self._there[places].all():
            empty = np.flatnonzero(~(self._there | self._left_out))
            if len(empty) >= self._enough:
                self._draw(empty, generator)
        there = self._there[places]
        stack.adopt(self._stack, places[there])
        self._there[places] = self._left_out[places] = False
        return places[~there]

    def _draw(
        self, places: NDArray[np.int64], generator: Callable[[int], np.random.Generator]
    ) -> None:
        drawn = self._sampler.sample([generator(place) for place in places.tolist()])
        ends = drawn.structures.default_ends
        tables = Tables.of_many(drawn.structures, *ends, normalised=self._normalised)
        filled = places[drawn.numbers]
        self._stack.load_many(filled, drawn.structures, ends, tables)
        self._left_out[places] = True
        self._left_out[filled] = False
        self._there[filled] = True
        for place, before in zip(filled.tolist(), drawn.before, strict=True):
            self._before[place] = before

    def forget(self, place: int, generator: np.random.Generator | None) -> None:
        """Drop the labyrinth of a sub-environment.

        Args:
            place: The number of the sub-environment.
            generator: Its generator, whose state is restored; None if it has been replaced.
        """
        if self._there[place] and generator is not None:
            generator.bit_generator.state = self._before[place]
        self._there[place] = self._left_out[place] = False

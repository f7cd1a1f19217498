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
        self._ready = np.zeros(count, np.bool_)
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
        slots: NDArray[np.int64],
        generator: Callable[[int], np.random.Generator],
    ) -> NDArray[np.int64]:
        """Load the next labyrinths into some slots of a stack.

        Args:
            stack: The stack of the sub-environments.
            slots: The sub-environments that begin an episode.
            generator: Returns the generator of a sub-environment.

        Returns:
            The slots left without a labyrinth; their generators are ready to draw it.
        """
        if not self._ready[slots].all():
            empty = np.flatnonzero(~(self._ready | self._left_out))
            if len(empty) >= self._enough:
                self._draw(empty, generator)
        ready = self._ready[slots]
        stack.adopt(self._stack, slots[ready])
        self._ready[slots] = self._left_out[slots] = False
        return slots[~ready]

    def _draw(
        self, slots: NDArray[np.int64], generator: Callable[[int], np.random.Generator]
    ) -> None:
        drawn = self._sampler.sample([generator(slot) for slot in slots.tolist()])
        ends = drawn.structures.default_ends
        tables = Tables.of_many(drawn.structures, *ends, normalised=self._normalised)
        filled = slots[drawn.numbers]
        self._stack.load_many(filled, drawn.structures, ends, tables)
        self._left_out[slots] = True
        self._left_out[filled] = False
        self._ready[filled] = True
        for slot, before in zip(filled.tolist(), drawn.before, strict=True):
            self._before[slot] = before

    def forget(self, slot: int, generator: np.random.Generator | None) -> None:
        """Drop the labyrinth of a sub-environment.

        Args:
            slot: The number of the sub-environment.
            generator: Its generator, whose state is restored; None if it has been replaced.
        """
        if self._ready[slot] and generator is not None:
            generator.bit_generator.state = self._before[slot]
        self._ready[slot] = self._left_out[slot] = False

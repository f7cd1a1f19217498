"""The tables of many labyrinths of one size and task, stacked in arrays, and the agents' states.

A state has an index within its labyrinth and an index in the whole stack. The tables hold the
latter, so a step of all agents is one look-up instead of a loop.

`NextLabyrinths` samples the next labyrinths of hundreds of sub-environments together, since
sampling them one at a time takes ten times as long. Each labyrinth still comes from the generator
of its sub-environment, and is the one that a single environment would draw.
"""

from __future__ import annotations

from collections.abc import Callable
from math import isqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.env.labyrinth_source import Shape
from labyrinth_core.language import dump, dump_many, labyrinth_id, parse
from labyrinth_core.pictures import VectorLayout
from labyrinth_core.world import (
    BatchSampler,
    Labyrinth,
    Look,
    Structures,
    Tables,
    Task,
    seen_together,
)


class Stack:
    """Many labyrinths and the state of the agent in each."""

    def __init__(self, count: int, height: int, width: int, task: Task) -> None:
        """Make room for `count` labyrinths; each slot must be loaded before it is used."""
        self._height, self._width, self._task = height, width, task
        states = height * width * task.rules.phases
        self.labyrinths: list[Labyrinth | None] = [None] * count
        """The labyrinth in each slot; None if not loaded, or if `at` has yet to parse its text."""
        self._first = np.arange(count, dtype=np.int64) * states
        """The index in the stack of each labyrinth's first state."""
        self._initial = self._first.copy()
        self._now = self._first.copy()
        self._transitions = np.zeros((count, states, 4), np.int64)
        self._rewards = np.zeros((count, states))
        self._terminal = np.zeros((count, states), np.bool_)
        self._distances = np.zeros((count, states), np.int64)
        self._optimal = np.zeros((count, states, 4), np.bool_)
        self._names = np.full((2, count), None, object)
        """The id and the text of each labyrinth."""
        self._shared_names: NDArray[np.object_] | None = None
        """A read-only copy for the infos, renewed when a labyrinth has changed."""
        self._layout = VectorLayout(height, width, task)
        self.initial_vectors = np.zeros((count, self._layout.length), np.int32)
        """The vector of each labyrinth's initial state, with nothing hidden."""
        self.looks = np.zeros(count, np.intp)
        """The look of each labyrinth, as an index in `Look`."""

    def load(self, slot: int, labyrinth: Labyrinth, tables: Tables) -> None:
        """Put a labyrinth into a slot."""
        vector, look = self._layout.initial(labyrinth), labyrinth.look
        self._load(np.array([slot]), tables, [dump(labyrinth)], vector, look)
        self.labyrinths[slot] = labyrinth

    def load_many(
        self,
        slots: NDArray[np.int64],
        structures: Structures,
        ends: tuple[int, int],
        tables: Tables,
    ) -> None:
        """Put labyrinths without tiles, all with the same start and goal, into the given slots."""
        vectors = self._layout.initial_of(structures, ends)
        self._load(slots, tables, dump_many(structures, *ends, self._task), vectors, Look.PLAIN)

    def _load(
        self,
        slots: NDArray[np.int64],
        tables: Tables,
        texts: list[str],
        vectors: NDArray[np.int32],
        look: Look,
    ) -> None:
        first = self._first[slots]
        self._initial[slots] = first + tables.initial
        self._transitions[slots] = tables.transitions + first[:, None, None]
        self._rewards[slots] = tables.rewards
        self._terminal[slots] = tables.terminal
        self._distances[slots] = tables.distances
        self._optimal[slots] = tables.optimal_actions
        self._names[:, slots] = [labyrinth_id(text) for text in texts], texts
        self.initial_vectors[slots] = vectors
        self.looks[slots] = [*Look].index(look)
        self._changed(slots)

    def adopt(self, other: Stack, slots: NDArray[np.int64]) -> None:
        """Copy the labyrinths in some slots of another stack into the same slots here."""
        for ours, theirs in zip(self._arrays(), other._arrays(), strict=True):
            ours[slots] = theirs[slots]
        self._names[:, slots] = other._names[:, slots]
        self._changed(slots)

    def _arrays(self) -> tuple[NDArray[Any], ...]:
        """Return the arrays with a row for each labyrinth."""
        tables = self._initial, self._transitions, self._rewards, self._terminal
        return *tables, self._distances, self._optimal, self.initial_vectors, self.looks

    def _changed(self, slots: NDArray[np.int64]) -> None:
        for slot in slots.tolist():
            self.labyrinths[slot] = None
        self._shared_names = None

    def at(self, slot: int) -> tuple[Labyrinth, int]:
        """Return the labyrinth in a slot, and the index of its state within it."""
        labyrinth = self.labyrinths[slot]
        if labyrinth is None:
            self.labyrinths[slot] = labyrinth = parse(self._names[1, slot])
        return labyrinth, int(self._now[slot] - self._first[slot])

    def restart(self, mask: NDArray[np.bool_]) -> None:
        """Reset the agents of a mask to their initial states."""
        np.copyto(self._now, self._initial, where=mask)

    def step(self, actions: NDArray[np.int64]) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
        """Take an action in each, shape (count,); return rewards and which episodes terminate."""
        self._now = self._transitions.ravel().take(4 * self._now + actions)
        return self._rewards.ravel().take(self._now), self._terminal.ravel().take(self._now)

    def states(self) -> NDArray[np.int64]:
        """Return the index of each agent's state within its labyrinth, shape (count,)."""
        states: NDArray[np.int64] = self._now - self._first
        return states

    def infos(self) -> dict[str, NDArray[Any]]:
        """Return the infos of all environments by name, as arrays of `count` rows.

        The string arrays are read-only and reused until a labyrinth changes, since copying them
        would touch every string. The other arrays are new.
        """
        if self._shared_names is None:
            self._shared_names = self._names.copy()
            self._shared_names.setflags(write=False)
        distance = self._distances.ravel().take(self._now)
        return {
            "labyrinth_id": self._shared_names[0],
            "labyrinth": self._shared_names[1],
            "optimal_actions": self._optimal.reshape(-1, 4).take(self._now, axis=0),
            "distance": distance,
            "is_success": distance == 0,
        }

    def vectors(self) -> NDArray[np.int32]:
        """Return `vector.vector_observation` of each agent, a new array, shape (count, length)."""
        vectors: NDArray[np.int32] = self.initial_vectors.copy()
        visible = self.visible() if self._task.rules.hides else None
        self._layout.show(vectors, self.states(), visible)
        return vectors

    def visible(self) -> NDArray[np.bool_]:
        """Return `Structure.visible_from` for each agent, shape (count, height, width)."""
        side = max(self._height, self._width)
        seen = seen_together(self._transitions.reshape(-1, 4), self._now, side)
        return seen.reshape(-1, self._height, self._width)


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

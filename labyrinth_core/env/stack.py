"""The tables of many labyrinths of one size and task, stacked in arrays, and the agents' states.

A state has an index within its labyrinth and an index in the whole stack. The tables hold the
latter, so a step of all agents is one look-up instead of a loop.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.language import dump, dump_many, labyrinth_id, parse
from labyrinth_core.pictures import VectorLayout
from labyrinth_core.world import Labyrinth, Look, Structures, Tables, Task, seen_together


class Stack:
    """Many labyrinths and the state of the agent in each."""

    def __init__(self, count: int, height: int, width: int, task: Task) -> None:
        """Make room for `count` labyrinths; each place must be loaded before it is used."""
        self._height, self._width, self._task = height, width, task
        states = height * width * task.rules.phases
        self.labyrinths: list[Labyrinth | None] = [None] * count
        """The labyrinth in each place; None if not loaded, or if `at` has yet to parse its text."""
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

    def load(self, place: int, labyrinth: Labyrinth, tables: Tables) -> None:
        """Put a labyrinth into a place."""
        vector, look = self._layout.initial(labyrinth), labyrinth.look
        self._load(np.array([place]), tables, [dump(labyrinth)], vector, look)
        self.labyrinths[place] = labyrinth

    def load_many(
        self,
        places: NDArray[np.int64],
        structures: Structures,
        ends: tuple[int, int],
        tables: Tables,
    ) -> None:
        """Put labyrinths without tiles, all with the same start and goal, into the given places."""
        vectors = self._layout.initial_of(structures, ends)
        self._load(places, tables, dump_many(structures, *ends, self._task), vectors, Look.PLAIN)

    def _load(
        self,
        places: NDArray[np.int64],
        tables: Tables,
        texts: list[str],
        vectors: NDArray[np.int32],
        look: Look,
    ) -> None:
        first = self._first[places]
        self._initial[places] = first + tables.initial
        self._transitions[places] = tables.transitions + first[:, None, None]
        self._rewards[places] = tables.rewards
        self._terminal[places] = tables.terminal
        self._distances[places] = tables.distances
        self._optimal[places] = tables.optimal_actions
        self._names[:, places] = [labyrinth_id(text) for text in texts], texts
        self.initial_vectors[places] = vectors
        self.looks[places] = [*Look].index(look)
        self._changed(places)

    def adopt(self, other: Stack, places: NDArray[np.int64]) -> None:
        """Copy the labyrinths in some places of another stack into the same places here."""
        for ours, theirs in zip(self._arrays(), other._arrays(), strict=True):
            ours[places] = theirs[places]
        self._names[:, places] = other._names[:, places]
        self._changed(places)

    def _arrays(self) -> tuple[NDArray[Any], ...]:
        """Return the arrays with a row for each labyrinth."""
        tables = self._initial, self._transitions, self._rewards, self._terminal
        return *tables, self._distances, self._optimal, self.initial_vectors, self.looks

    def _changed(self, places: NDArray[np.int64]) -> None:
        for place in places.tolist():
            self.labyrinths[place] = None
        self._shared_names = None

    def at(self, place: int) -> tuple[Labyrinth, int]:
        """Return the labyrinth in a place, and the index of its state within it."""
        labyrinth = self.labyrinths[place]
        if labyrinth is None:
            self.labyrinths[place] = labyrinth = parse(self._names[1, place])
        return labyrinth, int(self._now[place] - self._first[place])

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

"""A memory of demonstrated routes: the shortest of them that is open in a labyrinth.

An agent that remembers routes and sees which of them is open has learnt nothing about labyrinths,
so what it achieves tells how much of a success memory explains.
"""

from __future__ import annotations

from collections.abc import Iterable
from itertools import pairwise

from labyrinth_core.world.dynamics import initial, state_index, transition_table
from labyrinth_core.world.labyrinth import Labyrinth

_Tree = dict[int, "_Tree"]
"""Next cell -> what follows it in the routes."""


class RouteMemory:
    """Routes as the cells that were visited one after the other; steps into walls leave no trace.

    Any part of a route may be used, such as the rest of it from a cell on its way.
    """

    def __init__(self, routes: Iterable[Iterable[int]]) -> None:
        """Remember routes, each given as the cell that the agent was in after each step."""
        self._routes = dict.fromkeys(map(_without_stays, routes))
        self._cell = -1
        self._onward: _Tree = {}
        """The ways on from `_cell`; those from all cells at once would be very many."""

    def best(self, labyrinth: Labyrinth) -> list[int] | None:
        """Return the actions of the shortest remembered way from start to goal, None if none is.

        A way is open if no wall, locked door or ice is on it.
        """
        table, cells = transition_table(labyrinth), labyrinth.structure.cells
        first = state_index(labyrinth, initial(labyrinth))
        ways: list[tuple[int, _Tree, list[int]]] = [(first, self._ways(first % cells), [])]
        for state, onward, actions in ways:
            if state % cells == labyrinth.goal:
                return actions
            for action, after in enumerate(table[state]):
                cell = after % cells
                if after != state and cell in onward and cell not in labyrinth.ice:
                    ways.append((after, onward[cell], [*actions, action]))
        return None

    def _ways(self, cell: int) -> _Tree:
        if cell != self._cell:
            self._cell, self._onward = cell, {}
            for route in self._routes:
                for place in (place for place, visited in enumerate(route) if visited == cell):
                    node = self._onward
                    for following in route[place + 1 :]:
                        node = node.setdefault(following, {})
        return self._onward


def _without_stays(route: Iterable[int]) -> tuple[int, ...]:
    cells = tuple(route)
    return cells[:1] + tuple(after for before, after in pairwise(cells) if after != before)

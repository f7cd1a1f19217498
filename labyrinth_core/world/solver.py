"""Solve labyrinths: distances, optimal actions, shortest, simple and remembered routes.

A `Solver` works on the numbered states of a labyrinth, so the same code solves every task: in key
and door the search covers agent, key and door; ice is a terminal state.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import islice, pairwise

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.checks import whole
from labyrinth_core.world.labyrinth import Labyrinth
from labyrinth_core.world.structure import UNREACHABLE, Moves, breadth_first

Randomness = np.random.Generator | Callable[[], np.random.Generator]
"""A generator, or a function that makes one if needed: making one takes longer than solving 5x5."""


class Solver:
    """The states of a labyrinth with their distances from the goal, and the routes there."""

    table: Sequence[Moves]
    """For each state, the states that the four actions lead to."""
    distances: Sequence[int]
    """The least number of moves from each state to the goal, or `UNREACHABLE`."""

    def __init__(self, labyrinth: Labyrinth) -> None:
        """Search the states of a labyrinth from its goal."""
        self.labyrinth = labyrinth
        self.table = labyrinth.transition_table()
        if labyrinth.door is None:
            self.distances = labyrinth.cell_distances
            return
        cells = labyrinth.structure.cells
        predecessors: list[list[int]] = [[] for _ in self.table]
        for state, successors in enumerate(self.table):
            for successor in successors:
                predecessors[successor].append(state)
        goals = range(labyrinth.goal, len(self.table), cells)
        # The agent cannot stand on a closed door, so the search does not pass through these states.
        closed = (labyrinth.door, labyrinth.door + cells)
        self.distances = breadth_first(predecessors, goals, closed)

    @property
    def moves(self) -> int:
        """The number of moves of a shortest route from the start to the goal."""
        return self.distances[self.labyrinth.start]

    @property
    def tiles_matter(self) -> bool:
        """Whether the tiles of the task, if it has any, make the best route longer."""
        labyrinth = self.labyrinth
        least = labyrinth.structure.least_moves(labyrinth.start, labyrinth.goal)
        return not labyrinth.task.rules.tiles or self.moves > least

    def optimal_actions(self) -> NDArray[np.bool_]:
        """Return which actions begin a shortest route, a boolean array of shape (states, 4).

        Rows are all False for the goal, for ice, and for states that cannot reach the goal.
        """
        distance = np.array(self.distances)
        after = distance[np.array(self.table)]
        optimal: NDArray[np.bool_] = (after != UNREACHABLE) & (after == distance[:, None] - 1)
        return optimal

    def shortest_route(self, rng: Randomness) -> list[int]:
        """Return the actions of a shortest route, drawn uniformly from all shortest routes."""
        table, distance, state = self.table, self.distances, self.labyrinth.start
        routes: dict[int, int] = {}
        actions = []
        while distance[state]:
            nearer = distance[state] - 1
            up, right, down, left = table[state]
            after = (distance[up], distance[right], distance[down], distance[left])
            action = after.index(nearer)
            if after.count(nearer) > 1:
                routes = routes or self._count_shortest_routes(state)
                rng = rng() if callable(rng) else rng
                # Choose each action in proportion to the number of routes that begin with it: the
                # ticket is uniform below the number of routes, with a bias below 2 ** -64.
                length = routes[state].bit_length() // 8 + 9
                ticket = int.from_bytes(rng.bytes(length), "little") * routes[state] >> 8 * length
                for action in self._choices(state):
                    ticket -= routes[table[state][action]]
                    if ticket < 0:
                        break
            actions.append(action)
            state = table[state][action]
        return actions

    def erring_route(self, noise: float, rng: np.random.Generator) -> list[int]:
        """Return the actions of a noisy demonstrator, up to the goal, ice or the step limit.

        Args:
            noise: The probability of a uniformly random action, which may be optimal by chance.
                Otherwise the demonstrator takes one of the optimal actions, each equally likely.
            rng: The source of all randomness.
        """
        labyrinth, table, optimal = self.labyrinth, self.table, self.optimal_actions()
        cells, ends = labyrinth.structure.cells, {labyrinth.goal, *labyrinth.ice}
        state = labyrinth.start
        actions: list[int] = []
        while state % cells not in ends and len(actions) < labyrinth.step_limit:
            choices = np.arange(4) if rng.random() < noise else np.flatnonzero(optimal[state])
            actions.append(int(choices[rng.integers(len(choices))]))
            state = table[state][actions[-1]]
        return actions

    def moves_and_routes(self) -> tuple[int, int]:
        """Return the number of moves of a shortest route, and the number of such routes."""
        table, distance, state = self.table, self.distances, self.labyrinth.start
        moves = distance[state]
        for nearer in range(moves - 1, -1, -1):
            up, right, down, left = table[state]
            after = (distance[up], distance[right], distance[down], distance[left])
            if after.count(nearer) > 1:  # All shortest routes agree up to here.
                return moves, self._count_shortest_routes(state)[state]
            state = table[state][after.index(nearer)]
        return moves, 1

    def count_optimal(self, routes: Iterable[Iterable[int]]) -> int:
        """Return how many actions of routes from the start are optimal."""
        table, distance = self.table, self.distances
        count = 0
        for route in routes:
            state = self.labyrinth.start
            for action in route:
                after = table[state][action]
                count += 0 <= distance[after] < distance[state]
                state = after
        return count

    def shortest_routes(self, limit: int | None = None) -> list[list[int]]:
        """Return the actions of every shortest route, in the order of the actions.

        Args:
            limit: Stop after this many routes; None for all.

        Raises:
            ValueError: The limit is not a non-negative integer.
        """
        limit = None if limit is None else whole("limit", limit, 0)

        def onward(state: int) -> Iterator[tuple[int, int]]:
            return ((action, self.table[state][action]) for action in self._choices(state))

        return list(islice(self._routes(onward), limit))

    def simple_routes(self, limit: int | None = None) -> list[list[int]]:
        """Return the actions of every route that visits no state twice, shortest first.

        In key and door the agent may return to a cell with the key, since that is another state.

        Args:
            limit: Stop after this many routes, not always the shortest; None for all.

        Raises:
            ValueError: The limit is not a non-negative integer.
        """
        limit = None if limit is None else whole("limit", limit, 0)
        routes = islice(self._routes(lambda state: enumerate(self.table[state])), limit)
        return sorted(routes, key=lambda actions: (len(actions), actions))

    def _routes(self, onward: Callable[[int], Iterable[tuple[int, int]]]) -> Iterator[list[int]]:
        """Yield the actions of every route that visits no state twice, in the order of `onward`.

        The search is depth first. A state left without reaching the goal stays closed, because
        every way on from it leads back to the current path. So each dead end is entered once per
        route, not once per move, and finding the next route takes about as long as one walk through
        the whole labyrinth. When the search abandons a path that did reach the goal, the states
        that were closed because of this path open again.

        Args:
            onward: Returns the actions allowed in a state, each with the state that it leads to.
        """
        labyrinth, states = self.labyrinth, len(self.table)
        goals = range(labyrinth.goal, states, labyrinth.structure.cells)
        start = labyrinth.start
        closed = bytearray(states)
        for state in (start, *labyrinth.ice):
            closed[state] = True
        dead_ends: list[int] = []
        actions: list[int] = []
        path = [(start, iter(onward(start)), 0)]
        fruitful = 0  # How many states, from the start of the path, have led to the goal.
        while path:
            state, moves, before = path[-1]
            for action, after in moves:
                if after in goals:
                    fruitful = len(path)
                    yield [*actions, action]
                elif not closed[after]:
                    closed[after] = True
                    actions.append(action)
                    path.append((after, iter(onward(after)), len(dead_ends)))
                    break
            else:
                path.pop()
                del actions[-1:]
                dead_ends.append(state)
                if len(path) < fruitful:
                    fruitful = len(path)
                    for dead_end in dead_ends[before:]:
                        closed[dead_end] = False
                    del dead_ends[before:]

    def _choices(self, state: int) -> list[int]:
        """Return the optimal actions in a state that is not the goal."""
        nearer = self.distances[state] - 1
        return [
            action
            for action, after in enumerate(self.table[state])
            if self.distances[after] == nearer
        ]

    def _count_shortest_routes(self, start: int) -> dict[int, int]:
        """Return the number of shortest routes from each state that a shortest route visits."""
        table, distance = self.table, self.distances
        ahead: dict[int, list[int]] = {}
        queue = [start]
        for state in queue:  # The queue grows during the loop.
            if state not in ahead:
                nearer = distance[state] - 1
                ahead[state] = [after for after in table[state] if distance[after] == nearer >= 0]
                queue += ahead[state]
        routes: dict[int, int] = {}
        for state in reversed(ahead):
            routes[state] = sum(map(routes.__getitem__, ahead[state])) or 1
        return routes


def optimal_actions(labyrinth: Labyrinth) -> NDArray[np.bool_]:
    """Return which actions begin a shortest route, a boolean array of shape (states, 4).

    Rows are all False for the goal, for ice, and for states that cannot reach the goal.
    """
    return Solver(labyrinth).optimal_actions()


def shortest_route(labyrinth: Labyrinth, rng: Randomness) -> list[int]:
    """Return the actions of a shortest route, drawn uniformly from all shortest routes."""
    return Solver(labyrinth).shortest_route(rng)


_Tree = dict[int, "_Tree"]
"""Next cell -> the tree of the cells that follow it in the routes."""


class RouteMemory:
    """Remembered routes, as sequences of visited cells without the steps into walls.

    Any part of a route can be reused, for example its end from some cell on. An agent that picks a
    remembered route that is open has learnt nothing about labyrinths, so its success shows how much
    of another agent's success memory alone explains.
    """

    def __init__(self, routes: Iterable[Iterable[int]]) -> None:
        """Remember routes, each given as the agent's cell after each step."""
        self._routes: dict[tuple[int, ...], None] = {}
        for cells in map(tuple, routes):
            moves = (after for before, after in pairwise(cells) if after != before)
            self._routes[(*cells[:1], *moves)] = None
        self._cell = -1
        self._onward: _Tree = {}
        """The ways on from `_cell`, cached for one cell, as a tree per cell would be very large."""

    def best(self, labyrinth: Labyrinth) -> list[int] | None:
        """Return the actions of the shortest open way that is remembered from start to goal.

        A way is open if no wall, locked door or ice blocks it. Return None if no way is open.
        """
        table, cells = labyrinth.transition_table(), labyrinth.structure.cells
        first = labyrinth.start
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
                for step in (step for step, visited in enumerate(route) if visited == cell):
                    node = self._onward
                    for following in route[step + 1 :]:
                        node = node.setdefault(following, {})
        return self._onward

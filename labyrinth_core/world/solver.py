"""Routes: distances, optimal actions, shortest routes, simple routes, and remembered routes.

Functions of a labyrinth work on the numbered states of `dynamics`, so each task is solved by the
same code: in key and door the search runs over agent, key and door; ice is a terminal state.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import lru_cache
from itertools import islice, pairwise

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.world.dynamics import initial, state_index, step_limit, transition_table
from labyrinth_core.world.labyrinth import (
    UNREACHABLE,
    Labyrinth,
    Moves,
    Structure,
    breadth_first,
    whole,
)

Table = Sequence[Moves]

Randomness = np.random.Generator | Callable[[], np.random.Generator]
"""A generator, or a function that makes one: making one takes longer than solving 5x5."""


def table_and_distances(labyrinth: Labyrinth) -> tuple[Table, Sequence[int]]:
    """Return the transition table, and the least moves from each state to the goal.

    They are `UNREACHABLE` for a state from which no route leads there.
    """
    if labyrinth.door is None:  # The labyrinth itself keeps them.
        return transition_table(labyrinth), labyrinth.cell_distances
    return _with_door(labyrinth, labyrinth.door)


@lru_cache(maxsize=1)  # A build asks for a route, then for their number: 0.22 instead of 0.42 ms.
def _with_door(labyrinth: Labyrinth, door: int) -> tuple[Table, Sequence[int]]:
    table, cells = transition_table(labyrinth), labyrinth.structure.cells
    predecessors: list[list[int]] = [[] for _ in table]
    for state, successors in enumerate(table):
        for successor in successors:
            predecessors[successor].append(state)
    goals = range(labyrinth.goal, len(table), cells)
    # The agent cannot stand on a closed door: no action leads there, and none may lead away.
    return table, breadth_first(predecessors, goals, (door, door + cells))


def distances(labyrinth: Labyrinth) -> Sequence[int]:
    """Return the least number of moves from each state to the goal, or `UNREACHABLE`."""
    return table_and_distances(labyrinth)[1]


def moves_of(labyrinth: Labyrinth) -> int:
    """Return the number of moves of a shortest route from the start to the goal."""
    return distances(labyrinth)[labyrinth.start]


def least_moves(structure: Structure, source: int, target: int) -> int:
    """Return the least number of moves between two cells of a structure, or `UNREACHABLE`.

    All cells are flooded at once, as a bit set, which is quicker than `Structure.distances`.
    """
    up, right, width = structure.up, structure.right, structure.width
    reached, moves = 1 << source, 0
    while not reached >> target & 1:
        beside = (reached & right) << 1 | reached >> 1 & right
        flooded = reached | (reached & up) << width | reached >> width & up | beside
        if flooded == reached:
            return UNREACHABLE
        reached, moves = flooded, moves + 1
    return moves


def optimal_actions(labyrinth: Labyrinth) -> NDArray[np.bool_]:
    """Return which actions begin a shortest route, shape (states, 4).

    The rows of the goal, of ice, and of states without a way to the goal are all False.
    """
    table, found = table_and_distances(labyrinth)
    distance = np.array(found)
    after = distance[np.array(table)]
    optimal: NDArray[np.bool_] = (after != UNREACHABLE) & (after == distance[:, None] - 1)
    return optimal


def _choices(table: Table, distance: Sequence[int], state: int) -> list[int]:
    """Return the optimal actions in a state that is not the goal."""
    nearer = distance[state] - 1
    return [action for action, after in enumerate(table[state]) if distance[after] == nearer]


def shortest_route(labyrinth: Labyrinth, rng: Randomness) -> list[int]:
    """Return the actions of one shortest route, each such route being equally likely."""
    table, distance = table_and_distances(labyrinth)
    state = state_index(labyrinth, initial(labyrinth))
    routes: dict[int, int] = {}
    actions = []
    while distance[state]:
        nearer = distance[state] - 1
        up, right, down, left = table[state]
        after = (distance[up], distance[right], distance[down], distance[left])
        action = after.index(nearer)
        if after.count(nearer) > 1:
            routes = routes or _count_shortest_routes(table, distance, state)
            rng = rng() if callable(rng) else rng
            # A choice weighs as much as the number of routes behind it.
            ticket = _uniform_below(routes[state], rng)
            for action in _choices(table, distance, state):
                ticket -= routes[table[state][action]]
                if ticket < 0:
                    break
        actions.append(action)
        state = table[state][action]
    return actions


def erring_route(labyrinth: Labyrinth, noise: float, rng: np.random.Generator) -> list[int]:
    """Return the actions of a demonstrator who errs, up to the goal, ice or the step limit.

    Args:
        labyrinth: The labyrinth.
        noise: The probability of a uniformly random action, which may be optimal by chance;
            otherwise one of the optimal actions is taken, each equally likely.
        rng: The source of all randomness.
    """
    table, optimal = transition_table(labyrinth), optimal_actions(labyrinth)
    cells, ends = labyrinth.structure.cells, {labyrinth.goal, *labyrinth.ice}
    state = state_index(labyrinth, initial(labyrinth))
    actions: list[int] = []
    while state % cells not in ends and len(actions) < step_limit(labyrinth):
        choices = np.arange(4) if rng.random() < noise else np.flatnonzero(optimal[state])
        actions.append(int(choices[rng.integers(len(choices))]))
        state = table[state][actions[-1]]
    return actions


def moves_and_routes(labyrinth: Labyrinth) -> tuple[int, int]:
    """Return the number of moves of a shortest route, and the number of such routes."""
    table, distance = table_and_distances(labyrinth)
    state = state_index(labyrinth, initial(labyrinth))
    moves = distance[state]
    for nearer in range(moves - 1, -1, -1):
        up, right, down, left = table[state]
        after = (distance[up], distance[right], distance[down], distance[left])
        if after.count(nearer) > 1:  # Up to here all routes are the same.
            return moves, _count_shortest_routes(table, distance, state)[state]
        state = table[state][after.index(nearer)]
    return moves, 1


def count_optimal(labyrinth: Labyrinth, routes: Iterable[Iterable[int]]) -> int:
    """Return how many actions of the given routes, each from the start, begin a shortest route."""
    table, distance = table_and_distances(labyrinth)
    start, count = state_index(labyrinth, initial(labyrinth)), 0
    for route in routes:
        state = start
        for action in route:
            after = table[state][action]
            count += 0 <= distance[after] < distance[state]
            state = after
    return count


def _count_shortest_routes(table: Table, distance: Sequence[int], start: int) -> dict[int, int]:
    """Return the number of shortest routes from each state that a shortest route visits."""
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


def _uniform_below(bound: int, rng: np.random.Generator) -> int:
    """Return a whole number from 0 to `bound` - 1; the bias is below 2 ** -64."""
    length = bound.bit_length() // 8 + 9
    return int.from_bytes(rng.bytes(length), "little") * bound >> 8 * length


def shortest_routes(labyrinth: Labyrinth, limit: int | None = None) -> list[list[int]]:
    """Return the actions of every shortest route, in the order of the actions.

    Args:
        labyrinth: The labyrinth to solve.
        limit: The number of routes to stop at.

    Raises:
        ValueError: The limit is not a whole number from 0 on.
    """
    limit = None if limit is None else whole("limit", limit, 0)
    table, distance = table_and_distances(labyrinth)

    def onward(state: int) -> Iterator[tuple[int, int]]:
        return ((action, table[state][action]) for action in _choices(table, distance, state))

    return list(islice(_routes(labyrinth, len(table), onward), limit))


def simple_routes(labyrinth: Labyrinth, limit: int | None = None) -> list[list[int]]:
    """Return the actions of every route that visits no state twice, shortest first.

    In key and door the agent may come back to a cell with the key, which is another state.

    Args:
        labyrinth: The labyrinth to solve.
        limit: The number of routes to stop at; those found first are not always the shortest.

    Raises:
        ValueError: The limit is not a whole number from 0 on.
    """
    limit = None if limit is None else whole("limit", limit, 0)
    table = transition_table(labyrinth)
    found = islice(_routes(labyrinth, len(table), lambda state: enumerate(table[state])), limit)
    return sorted(found, key=lambda actions: (len(actions), actions))


def _routes(
    labyrinth: Labyrinth, states: int, onward: Callable[[int], Iterable[tuple[int, int]]]
) -> Iterator[list[int]]:
    """Yield the actions of every route that visits no state twice, in the order of the moves.

    The search is depth first. A state that it left without reaching the goal stays closed, since
    every way from there leads back to the current path; so a dead end is entered once for a route,
    not once for each of its moves, and finding the next route takes about as long as a walk through
    the whole labyrinth. When a path that did reach the goal is given up, the states that were
    closed because of it open again.

    Args:
        labyrinth: The labyrinth, whose ice is not entered.
        states: The number of its states.
        onward: For a state the actions that may be taken and the states that they lead to.
    """
    goals = range(labyrinth.goal, states, labyrinth.structure.cells)
    start = state_index(labyrinth, initial(labyrinth))
    closed = bytearray(states)
    for state in (start, *labyrinth.ice):
        closed[state] = True
    dead_ends: list[int] = []
    actions: list[int] = []
    path = [(start, iter(onward(start)), 0)]
    fruitful = 0  # The number of states at the beginning of the path that have led to the goal.
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
                for each in dead_ends[before:]:
                    closed[each] = False
                del dead_ends[before:]


_Tree = dict[int, "_Tree"]
"""Next cell -> what follows it in the routes."""


class RouteMemory:
    """Routes as the cells that were visited one after the other; steps into walls leave no trace.

    Any part of a route may be used, such as the rest of it from a cell on its way. An agent that
    remembers routes and sees which of them is open has learnt nothing about labyrinths, so what it
    achieves tells how much of a success memory explains.
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

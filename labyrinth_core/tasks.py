"""Where start, goal, key, door and ice may lie: the rules of the sampler and of the language.

The tiles of a task are placed so that they matter: fetching the key is a detour, and the ice
lies on every shortest route, so that the best route without ice is longer.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice

import numpy as np

from labyrinth_core.grid import manhattan
from labyrinth_core.labyrinth import UNREACHABLE, Labyrinth, LabyrinthError, Structure, Task

MOST_ROUTES_TRIED = 1_000
"""After so many routes without one to lay ice beside, a structure counts as unfit for ice."""


def default_start_and_goal(height: int, width: int) -> tuple[int, int]:
    """Return the bottom left and the top right cell."""
    return 0, height * width - 1


def place(
    structure: Structure,
    start: int,
    goal: int,
    task: Task,
    rng: np.random.Generator,
    *,
    key: int | None = None,
    door: int | None = None,
) -> Labyrinth:
    """Return a labyrinth whose missing tiles of the task are placed at random.

    Args:
        structure: Its passages.
        start: Cell of the start.
        goal: Cell of the goal.
        task: The task to hold.
        rng: Chooses among the places that are possible.
        key: Cell of the key, if that is settled.
        door: Cell of the door, if that is settled.

    Raises:
        LabyrinthError: The structure cannot hold the task.
    """
    Labyrinth(structure, start, goal)  # Is start, goal or the way at fault, it says which.
    if task is Task.KEY_AND_DOOR:
        key, door = _place_key_and_door(structure, start, goal, rng, key, door)
        return Labyrinth(structure, start, goal, task, key=key, door=door)
    if task is Task.ICY_FLOOR:
        ice = _place_ice(structure, start, goal, rng)
        return Labyrinth(structure, start, goal, task, ice=ice)
    return Labyrinth(structure, start, goal, task)


def _place_key_and_door(
    structure: Structure,
    start: int,
    goal: int,
    rng: np.random.Generator,
    key: int | None,
    door: int | None,
) -> tuple[int, int]:
    doors = _unavoidable(structure, start, goal) if door is None else [door]
    if not doors:
        raise LabyrinthError("no place for the door: no cell lies on every route from S to E")
    from_start, from_goal = structure.distances(start), structure.distances(goal)
    for place in rng.permutation(len(doors)):
        before_door = structure.distances(start, [doors[place]])
        keys = [
            cell
            for cell, steps in enumerate(before_door)
            if steps > 0
            and cell != goal
            and from_start[cell] + from_goal[cell] > from_start[goal]
            and key in (None, cell)
        ]
        if keys:
            return keys[rng.integers(len(keys))], doors[place]
    if key is None:
        raise LabyrinthError("no place for the key: none is off the route and before the door")
    raise LabyrinthError("no place for the door that fits the key", key)


def _unavoidable(structure: Structure, start: int, goal: int) -> list[int]:
    """Return the cells between start and goal that every route visits, in linear time.

    Walk along one route and, from each of its cells, flood the cells beside the route. Where
    nothing found so far touches the route further on, there is no way around.
    """
    moves, distance = structure.moves, structure.distances(goal)
    if distance[start] == UNREACHABLE:
        return []
    route = [start]
    while route[-1] != goal:
        route.append(next(c for c in moves[route[-1]] if distance[c] == distance[route[-1]] - 1))
    place_on_route = {cell: place for place, cell in enumerate(route)}
    seen = set(route)
    farthest = 0
    unavoidable = []
    for place, cell in enumerate(route[:-1]):
        if place and place == farthest:
            unavoidable.append(cell)
        stack = [cell]
        while stack:
            for beside in moves[stack.pop()]:
                farthest = max(farthest, place_on_route.get(beside, 0))
                if beside not in seen:
                    seen.add(beside)
                    stack.append(beside)
    return unavoidable


def _place_ice(
    structure: Structure, start: int, goal: int, rng: np.random.Generator
) -> frozenset[int]:
    from_start, from_goal = structure.distances(start), structure.distances(goal)
    shortest = from_start[goal]
    on_shortest = [
        cell
        for cell in range(structure.cells)
        if cell not in (start, goal)
        and UNREACHABLE not in (from_start[cell], from_goal[cell])
        and from_start[cell] + from_goal[cell] == shortest
    ]
    # Close cells of shortest routes, one by one, as long as the goal stays within reach.
    closed: list[int] = []
    distance = from_goal
    for place in rng.permutation(len(on_shortest)):
        closed.append(on_shortest[place])
        without = structure.distances(goal, closed)
        if without[start] == UNREACHABLE:
            closed.pop()
            continue
        distance = without
        if distance[start] > shortest:
            break
    else:
        # The order was an unlucky one, or no order does: look at the routes themselves.
        return _ice_beside_a_longer_route(structure, start, goal, on_shortest, rng)
    # The ice covers the shortest routes except where a longer one, chosen here, needs them.
    longer = {start}
    cell = start
    while cell != goal:
        nearer = [c for c in structure.moves[cell] if distance[c] == distance[cell] - 1]
        cell = nearer[rng.integers(len(nearer))]
        longer.add(cell)
    return frozenset(on_shortest) - longer


def _ice_beside_a_longer_route(
    structure: Structure,
    start: int,
    goal: int,
    on_shortest: list[int],
    rng: np.random.Generator,
) -> frozenset[int]:
    """Return the cells of shortest routes that a longer route leaves out.

    With no shortcut among its own cells, the longer route holds no shortest one, so the ice
    closes them all; and where ice can matter at all, there is such a route.
    """
    shortest = structure.distances(start)[goal]
    for route in islice(_routes_without_shortcut(structure, start, goal, rng), MOST_ROUTES_TRIED):
        if len(route) > shortest + 1:
            return frozenset(on_shortest).difference(route)
    raise LabyrinthError("ice would not matter: no longer route leads around a shortest one")


def _routes_without_shortcut(
    structure: Structure, start: int, goal: int, rng: np.random.Generator
) -> Iterator[tuple[int, ...]]:
    """Yield the cells of each route on which passages join no two but successive cells.

    The order is random. Each beginning that is followed up has an end, so no time is lost.
    """
    moves = structure.moves
    stack: list[tuple[tuple[int, ...], frozenset[int]]] = [((start,), frozenset())]
    while stack:
        route, closed = stack.pop()
        at = route[-1]
        if goal in moves[at]:
            yield (*route, goal)
            continue
        to_goal = structure.distances(goal, closed | {at})
        onward = [cell for cell in moves[at] if to_goal[cell] != UNREACHABLE]
        closed = closed.union(moves[at], [at])
        stack.extend(((*route, cell), closed) for cell in rng.permutation(onward).tolist())


def tiles_matter(labyrinth: Labyrinth) -> bool:
    """Return whether the tiles are as `place` lays them: the key a detour, the ice in the way."""
    structure, start, goal = labyrinth.structure, labyrinth.start, labyrinth.goal
    if labyrinth.key is not None:
        from_start, from_goal = structure.distances(start), structure.distances(goal)
        detour = from_start[labyrinth.key] + from_goal[labyrinth.key]
        return detour > from_start[goal]
    if labyrinth.ice:
        without_ice = structure.distances(start, labyrinth.ice)
        return without_ice[goal] > structure.distances(start)[goal]
    return True


def change_start(labyrinth: Labyrinth, rng: np.random.Generator) -> Labyrinth:
    """Return the labyrinth with another start, far enough from the goal; tiles placed anew.

    Far enough is `(width + height) // 2` moves on a grid without walls, or as far as any other
    start can be.

    Raises:
        LabyrinthError: No other start can hold the task.
    """
    return _first_that_holds(labyrinth, _starts(labyrinth, labyrinth.goal, rng), rng)


def change_start_and_goal(labyrinth: Labyrinth, rng: np.random.Generator) -> Labyrinth:
    """Return the labyrinth with another start and another goal; otherwise as `change_start`."""
    goals = rng.permutation(labyrinth.structure.cells).tolist()
    pairs = (
        pair for goal in goals if goal != labyrinth.goal for pair in _starts(labyrinth, goal, rng)
    )
    return _first_that_holds(labyrinth, pairs, rng)


def _starts(labyrinth: Labyrinth, goal: int, rng: np.random.Generator) -> Iterator[tuple[int, int]]:
    """Yield `(start, goal)` for each start far enough from a goal, in random order."""
    structure = labyrinth.structure
    apart = {
        start: manhattan(start, goal, structure.width)
        for start in range(structure.cells)
        if start not in (goal, labyrinth.start)
    }
    far_enough = (structure.height + structure.width) // 2
    if goal == labyrinth.goal:
        far_enough = min(far_enough, max(apart.values()))
    starts = [start for start, moves in apart.items() if moves >= far_enough]
    yield from ((starts[choice], goal) for choice in rng.permutation(len(starts)))


def _first_that_holds(
    labyrinth: Labyrinth, pairs: Iterator[tuple[int, int]], rng: np.random.Generator
) -> Labyrinth:
    for start, goal in pairs:
        try:
            return place(labyrinth.structure, start, goal, labyrinth.task, rng)
        except LabyrinthError:
            continue
    raise LabyrinthError(f"no other start or goal can hold {labyrinth.task}")

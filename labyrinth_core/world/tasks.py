"""Where key, door and ice may lie: the rules of the sampler and of the language.

The tiles of a task are placed so that they matter: fetching the key is a detour, and the ice
lies on every shortest route, so that the best route without ice is longer.
"""

from __future__ import annotations

import numpy as np

from labyrinth_core.world.labyrinth import UNREACHABLE, Labyrinth, LabyrinthError, Structure, Task

ICE_SEARCH = 500_000
"""About how many cells to look at for a place for ice before giving up."""


def default_start_and_goal(height: int, width: int) -> tuple[int, int]:
    """Return the bottom left and the top right cell."""
    return 0, height * width - 1


def check_open_walls(task: Task, open_walls: float) -> None:
    """Refuse a task that no labyrinth can hold with this share of open walls.

    Args:
        task: The task.
        open_walls: The probability of opening each wall that the tree leaves.

    Raises:
        LabyrinthError: No labyrinth can hold the task.
    """
    wish = f"open_walls={open_walls:g} task={task}"
    if task is Task.ICY_FLOOR and open_walls == 0:
        raise LabyrinthError(f"{wish}: there is one route, and ice needs another; give more than 0")
    if task is Task.KEY_AND_DOOR and open_walls == 1:
        raise LabyrinthError(f"{wish}: no cell is on every route, for a door; give less than 1")


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
        key: Cell of the key; None to choose it.
        door: Cell of the door; None to choose it.

    Raises:
        LabyrinthError: The structure cannot hold the task.
    """
    if task in (Task.NAVIGATION, Task.PARTIAL_OBSERVABILITY):
        return Labyrinth(structure, start, goal, task)
    Labyrinth(structure, start, goal)  # Raises if start, goal or the way between them is at fault.
    if task is Task.KEY_AND_DOOR:
        key, door = _place_key_and_door(structure, start, goal, rng, key, door)
        return Labyrinth(structure, start, goal, task, key=key, door=door)
    ice = _place_ice(structure, start, goal, rng)
    return Labyrinth(structure, start, goal, task, ice=ice)


def _place_key_and_door(
    structure: Structure,
    start: int,
    goal: int,
    rng: np.random.Generator,
    key: int | None,
    door: int | None,
) -> tuple[int, int]:
    doors, found = _unavoidable(structure, start, goal)
    if door is not None:
        doors = {door: doors[door]} if door in doors else {}
    if not doors:
        raise LabyrinthError("no place for the door: no cell lies on every route from S to E", door)
    from_start, from_goal = structure.distances(start), structure.distances(goal)
    keys = [
        cell
        for cell in found
        if from_start[cell] + from_goal[cell] > from_start[goal] and key in (None, cell)
    ]
    first = min((found[cell] for cell in keys), default=structure.cells)
    doors = {cell: place for cell, place in doors.items() if place > first}
    if not doors and key is not None:
        raise LabyrinthError("no place for the door that fits the key", key)
    if not doors:
        raise LabyrinthError("no place for the key: none is off the route and before the door")
    door = list(doors)[rng.integers(len(doors))]
    keys = [cell for cell in keys if found[cell] < doors[door]]
    return keys[rng.integers(len(keys))], door


def _unavoidable(
    structure: Structure, start: int, goal: int
) -> tuple[dict[int, int], dict[int, int]]:
    """Return what lies on every route and what lies before it, in linear time.

    Walk along one shortest route and, from each of its cells, flood the cells beside the route.
    Where nothing found so far touches the route further on, there is no way around.

    Returns:
        The cells between start and goal that every route visits, and the cells off the route
        taken; both with the place along that route from which they were found. A cell off the
        route can be reached before a cell on every route if its place is the smaller.
    """
    moves, distance = structure.moves, structure.distances(goal)
    unavoidable: dict[int, int] = {}
    found: dict[int, int] = {}
    if distance[start] == UNREACHABLE:
        return unavoidable, found
    route = [start]
    while route[-1] != goal:
        route.append(next(c for c in moves[route[-1]] if distance[c] == distance[route[-1]] - 1))
    place_on_route = {cell: place for place, cell in enumerate(route)}
    farthest = 0
    for place, cell in enumerate(route[:-1]):
        if place and place == farthest:
            unavoidable[cell] = place
        stack = [cell]
        while stack:
            for beside in moves[stack.pop()]:
                on_route = place_on_route.get(beside)
                if on_route is not None:
                    farthest = max(farthest, on_route)
                elif beside not in found:
                    found[beside] = place
                    stack.append(beside)
    return unavoidable, found


def _place_ice(
    structure: Structure, start: int, goal: int, rng: np.random.Generator
) -> frozenset[int]:
    from_start, from_goal = structure.distances(start), structure.distances(goal)
    shortest = from_start[goal]
    on_shortest = {
        cell
        for cell in range(structure.cells)
        if from_start[cell] != UNREACHABLE and from_start[cell] + from_goal[cell] == shortest
    }
    closed = _closed_until_longer(structure, start, goal, rng)
    # The ice covers the shortest routes except where a longer one, chosen here, needs them.
    longer = _shortest_route(structure, start, structure.distances(goal, closed), rng)
    return frozenset(on_shortest.difference(longer))


def _closed_until_longer(
    structure: Structure, start: int, goal: int, rng: np.random.Generator
) -> list[int]:
    """Return cells of shortest routes without which the goal is farther, but within reach.

    Of each shortest route at least one cell has to be closed, so the search takes one of those
    left, closes each of its cells in turn, and goes on from there; a cell that did not help stays
    open after that. It finds such cells wherever there are any, unless it gives up.

    Raises:
        LabyrinthError: No such cells exist, or none were found in `ICE_SEARCH` steps.
    """
    shortest = structure.distances(goal)[start]
    searches = max(20, ICE_SEARCH // structure.cells)
    closed: list[int] = []
    choices: list[list[int]] = []
    open_for_good: list[set[int]] = [{start, goal}]
    while searches:
        distance = structure.distances(goal, closed)
        searches -= 1
        if distance[start] > shortest:
            return closed
        if distance[start] == UNREACHABLE:
            open_for_good[-1].add(closed.pop())
        else:
            route = _shortest_route(structure, start, distance, rng)
            choices.append([route[place] for place in rng.permutation(len(route))])
            open_for_good.append(set(open_for_good[-1]))
        while choices and not set(choices[-1]) - open_for_good[-1]:
            choices.pop()
            open_for_good.pop()
            if closed:
                open_for_good[-1].add(closed.pop())
        if not choices:
            raise LabyrinthError("ice would not matter: no longer route avoids a shortest one")
        cell = choices[-1].pop()
        while cell in open_for_good[-1]:
            cell = choices[-1].pop()
        closed.append(cell)
    raise LabyrinthError("no place was found for ice that would leave a longer route open")


def _shortest_route(
    structure: Structure, start: int, distance: list[int], rng: np.random.Generator
) -> list[int]:
    """Return the cells of a shortest route, given the distance of each cell from the goal."""
    route = [start]
    while distance[route[-1]]:
        nearer = distance[route[-1]] - 1
        cells = [cell for cell in structure.moves[route[-1]] if distance[cell] == nearer]
        route.append(cells[rng.integers(len(cells))] if len(cells) > 1 else cells[0])
    return route


def tiles_matter(labyrinth: Labyrinth) -> bool:
    """Return whether the tiles are as `place` lays them: the key a detour, the ice in the way."""
    structure, start, goal = labyrinth.structure, labyrinth.start, labyrinth.goal
    if labyrinth.key is not None:
        from_start, from_goal = structure.distances(start), structure.distances(goal)
        return from_start[labyrinth.key] + from_goal[labyrinth.key] > from_start[goal]
    if labyrinth.ice:
        return labyrinth.cell_distances[start] > structure.distances(goal)[start]
    return True

"""Place key, door and ice, and sample labyrinths; shared by sampler and language.

The tiles of a task are placed so that they matter: fetching the key is a detour, and the ice
lies on every shortest route, so that the best route without ice is longer.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from labyrinth_core.checks import whole
from labyrinth_core.world.labyrinth import Labyrinth
from labyrinth_core.world.rules import LabyrinthError, Look, Task
from labyrinth_core.world.structure import UNREACHABLE, Structure, checked_sides

ICE_SEARCH = 500_000
"""About how many cells the search for a place for ice visits before giving up."""
MAX_DRAWS = 10_000
"""The structures drawn before giving up; hundreds suffice wherever some structure fits the task."""


def _place_key_and_door(
    plain: Labyrinth, rng: np.random.Generator, key: int | None = None, door: int | None = None
) -> dict[str, Any]:
    doors, reached_from = _unavoidable(plain)
    if door is not None:
        doors = {door: doors[door]} if door in doors else {}
    if not doors:
        raise LabyrinthError("no place for the door: no cell lies on every route from S to E", door)
    from_start, from_goal = plain.structure.distances(plain.start), plain.cell_distances
    shortest = from_goal[plain.start]
    keys = [
        cell
        for cell in reached_from
        if from_start[cell] + from_goal[cell] > shortest and key in (None, cell)
    ]
    first = min((reached_from[cell] for cell in keys), default=plain.structure.cells)
    doors = {cell: step for cell, step in doors.items() if step > first}
    if not doors and key is not None:
        raise LabyrinthError("no place for the door that fits the key", key)
    if not doors:
        raise LabyrinthError("no place for the key: no cell before the door is a detour")
    door = list(doors)[rng.integers(len(doors))]
    keys = [cell for cell in keys if reached_from[cell] < doors[door]]
    return {"key": keys[rng.integers(len(keys))], "door": door}


def _unavoidable(plain: Labyrinth) -> tuple[dict[int, int], dict[int, int]]:
    """Return the cells on every route, and the cells that can be reached before them.

    Walk along one shortest route and, from each of its cells, flood the cells beside the route.
    If nothing found so far touches the route further on, every route visits the cell. Linear time.

    Returns:
        The cells between start and goal that every route visits, and the cells off the route
        walked, each with the index on that route from which it was found. A cell off the route can
        be reached before an unavoidable cell if its index is smaller.
    """
    moves, distance = plain.structure.moves, plain.cell_distances
    unavoidable: dict[int, int] = {}
    reached_from: dict[int, int] = {}
    route = [plain.start]
    while route[-1] != plain.goal:
        route.append(next(c for c in moves[route[-1]] if distance[c] == distance[route[-1]] - 1))
    step_of = {cell: step for step, cell in enumerate(route)}
    farthest = 0
    for step, cell in enumerate(route[:-1]):
        if step and step == farthest:
            unavoidable[cell] = step
        stack = [cell]
        while stack:
            for beside in moves[stack.pop()]:
                if beside in step_of:
                    farthest = max(farthest, step_of[beside])
                elif beside not in reached_from:
                    reached_from[beside] = step
                    stack.append(beside)
    return unavoidable, reached_from


def _place_ice(plain: Labyrinth, rng: np.random.Generator) -> dict[str, Any]:
    structure, from_goal = plain.structure, plain.cell_distances
    # The ice covers the shortest routes, except the cells that the longer route chosen here needs.
    longer = _shortest_route(structure, plain.start, _distances_when_longer(plain, rng), rng)
    from_start, shortest = structure.distances(plain.start), from_goal[plain.start]
    on_shortest = {
        cell
        for cell in range(structure.cells)
        if from_start[cell] != UNREACHABLE and from_start[cell] + from_goal[cell] == shortest
    }
    return {"ice": frozenset(on_shortest.difference(longer))}


def _distances_when_longer(plain: Labyrinth, rng: np.random.Generator) -> Sequence[int]:
    """Return each cell's distance from the goal with some cells of shortest routes closed.

    The goal is then farther from the start, but still reachable. Each shortest route needs a closed
    cell. So the search takes a shortest route that is still open, closes each of its cells in turn,
    and repeats this; a cell that did not help stays open from then on. The search finds a solution
    whenever one exists, unless it gives up.

    Raises:
        LabyrinthError: No such cells exist, or none were found in `ICE_SEARCH` steps.
    """
    structure, start, goal = plain.structure, plain.start, plain.goal
    distance, shortest = plain.cell_distances, plain.cell_distances[start]
    cuts: list[_Cut] = []
    for _ in range(max(20, ICE_SEARCH // structure.cells)):
        if cuts:
            distance = structure.distances(goal, [cut.closed for cut in cuts])
        if distance[start] > shortest:
            return distance
        if distance[start] == UNREACHABLE:
            cuts[-1].open_for_good.add(cuts[-1].closed)
        else:
            route = _shortest_route(structure, start, distance, rng)
            cells = [route[step] for step in rng.permutation(len(route))]
            cuts.append(_Cut(cells, {*(cuts[-1].open_for_good if cuts else (start, goal))}))
        while cuts and cuts[-1].open_for_good.issuperset(cuts[-1].cells):
            cuts.pop()
            if cuts:
                cuts[-1].open_for_good.add(cuts[-1].closed)
        if not cuts:
            raise LabyrinthError("no place for ice: blocking the shortest routes leaves no detour")
        cuts[-1].close_next()
    raise LabyrinthError("no place was found for ice that leaves a detour open")


@dataclass
class _Cut:
    """A shortest route that was open, and the one of its cells that is closed now."""

    cells: list[int]
    """The cells to close later, in random order, the last one first."""
    open_for_good: set[int]
    """The cells that are not closed, as this did not help on the routes up to this one."""
    closed: int = -1

    def close_next(self) -> None:
        """Close the next cell of the route that is not open for good."""
        self.closed = self.cells.pop()
        while self.closed in self.open_for_good:
            self.closed = self.cells.pop()


def _shortest_route(
    structure: Structure, start: int, distance: Sequence[int], rng: np.random.Generator
) -> list[int]:
    """Return the cells of a shortest route, given the distance of each cell from the goal."""
    route = [start]
    while distance[route[-1]]:
        nearer = distance[route[-1]] - 1
        cells = [cell for cell in structure.moves[route[-1]] if distance[cell] == nearer]
        route.append(cells[rng.integers(len(cells))] if len(cells) > 1 else cells[0])
    return route


PLACEMENTS: dict[Task, Callable[..., dict[str, Any]]] = {
    Task.KEY_AND_DOOR: _place_key_and_door,
    Task.ICY_FLOOR: _place_ice,
}
"""Task -> what places its tiles: it returns them as fields of `Labyrinth`, given the labyrinth
without them, a generator and the cells of single tiles that are not to be chosen; it raises
LabyrinthError if there is no place for them."""


class Placer(NamedTuple):
    """Places start, goal and tiles in structures at random."""

    rng: np.random.Generator

    def place(
        self,
        structure: Structure,
        start: int,
        goal: int,
        task: Task,
        *,
        look: Look = Look.PLAIN,
        **cells: int,
    ) -> Labyrinth:
        """Return a labyrinth with the task's missing tiles placed at random.

        Args:
            structure: Its passages.
            start: Cell of the start.
            goal: Cell of the goal.
            task: The task to hold.
            look: How pictures show it.
            cells: Cells of single tiles by name, such as `key`; the others are chosen.

        Raises:
            LabyrinthError: The structure cannot hold the task.
        """
        if not task.rules.tiles:
            return Labyrinth(structure, start, goal, task, look=look)
        plain = Labyrinth(structure, start, goal)  # Raises if no route leads from start to goal.
        tiles = PLACEMENTS[task](plain, self.rng, **cells)
        return Labyrinth(structure, start, goal, task, look=look, **tiles)

    def labyrinths(
        self,
        structures: Iterable[Structure],
        task: Task,
        ends: tuple[int, int] | None,
        allows: Callable[[Structure], bool] | None = None,
    ) -> Iterator[Labyrinth]:
        """Yield a labyrinth for each structure that is allowed and can hold the task.

        Args:
            structures: The structures, without end.
            task: The task to hold.
            ends: The cells of start and goal; None for random ones, as in `any_ends`.
            allows: Returns whether a structure may be used; None allows all.

        Raises:
            LabyrinthError: `MAX_DRAWS` structures in a row are not allowed or cannot hold the task.
        """
        failed = 0
        for structure in structures:
            if failed == MAX_DRAWS:
                raise LabyrinthError(f"none of {failed:,} structures can hold task={task}")
            failed += 1
            if allows is not None and not allows(structure):
                continue
            try:
                if ends is None:
                    labyrinth = self.any_ends(structure, task)
                else:
                    labyrinth = self.place(structure, *ends, task)
            except LabyrinthError:
                continue
            failed = 0
            yield labyrinth

    def any_ends(self, structure: Structure, task: Task) -> Labyrinth:
        """Return a labyrinth with random start and goal, far enough apart, and tiles placed.

        Far enough is `(width + height) // 2` moves on a grid without walls. The goal is drawn
        first, uniformly, and then the start, uniformly from the cells that are far enough from the
        goal. If this pair cannot hold the task, another is drawn.

        Raises:
            LabyrinthError: No start and goal can hold the task.
        """
        goals = self.rng.permutation(structure.cells).tolist()
        if task.rules.needs_loops and not structure.loops:
            goals = []  # Trying all pairs would take long.
        return self._moved(structure, task, goals)

    def other_start(self, labyrinth: Labyrinth) -> Labyrinth:
        """Return the labyrinth with another start, far enough from the goal, and new tiles.

        Far enough is `(width + height) // 2` moves on a grid without walls, or the distance of the
        farthest other start if that is less.

        Raises:
            LabyrinthError: No other start can hold the task.
        """
        return self._moved(labyrinth.structure, labyrinth.task, [labyrinth.goal], former=labyrinth)

    def other_goal(self, labyrinth: Labyrinth) -> Labyrinth:
        """Return the labyrinth with another goal, far enough from the start, and new tiles.

        Far enough is as for `other_start`.

        Raises:
            LabyrinthError: No other goal can hold the task.
        """
        for goal in self._ends(labyrinth.structure, labyrinth.start, labyrinth.goal, nearer=True):
            with suppress(LabyrinthError):
                structure, start, task = labyrinth.structure, labyrinth.start, labyrinth.task
                return self.place(structure, start, goal, task, look=labyrinth.look)
        raise LabyrinthError(f"no other goal can hold {labyrinth.task}")

    def other_ends(self, labyrinth: Labyrinth) -> Labyrinth:
        """Return the labyrinth with another start and another goal; otherwise as `other_start`."""
        goals = self.rng.permutation(labyrinth.structure.cells).tolist()
        goals.remove(labyrinth.goal)
        return self._moved(labyrinth.structure, labyrinth.task, goals, former=labyrinth)

    def changed(self, labyrinth: Labyrinth, task: Task, start: int, goal: int) -> Labyrinth:
        """Return the labyrinth with a task, start and goal, and new tiles if one of them differs.

        Raises:
            ValueError: Start and goal are the same cell, or the structure cannot hold the task.
        """
        if (task, start, goal) == (labyrinth.task, labyrinth.start, labyrinth.goal):
            return labyrinth
        wish = _wish_text(task, start, goal, labyrinth.structure.width)
        _check_apart(start, goal, wish)
        try:
            return self.place(labyrinth.structure, start, goal, task, look=labyrinth.look)
        except LabyrinthError as error:
            raise ValueError(f"{wish}: this labyrinth cannot hold it; {error}") from error

    def _moved(
        self,
        structure: Structure,
        task: Task,
        goals: list[int],
        former: Labyrinth | None = None,
    ) -> Labyrinth:
        """Return a labyrinth with the first of the goals, and a start, that can hold the task.

        The start differs from the start of `former`. If the goal stays the same and no start is
        far enough from it, the farthest ones are allowed.
        """
        former_start, former_goal, look = None, None, Look.PLAIN
        if former is not None:
            former_start, former_goal, look = former.start, former.goal, former.look
        for goal in goals:
            for start in self._ends(structure, goal, former_start, nearer=goal == former_goal):
                with suppress(LabyrinthError):
                    return self.place(structure, start, goal, task, look=look)
        other = "" if former is None else "other "
        raise LabyrinthError(f"no {other}start or goal can hold {task}")

    def _ends(
        self, structure: Structure, other: int, former: int | None, *, nearer: bool
    ) -> list[int]:
        """Return the cells that one end, start or goal, can move to, in random order.

        Args:
            structure: The structure.
            other: The cell of the other end, which has to be far enough away.
            former: The present cell of this end, which is excluded; None to exclude no cell.
            nearer: Whether to accept the farthest cells if no cell is far enough.
        """
        apart = {
            cell: structure.grid_distance(cell, other)
            for cell in range(structure.cells)
            if cell not in (other, former)
        }
        far_enough = (structure.height + structure.width) // 2
        if nearer:
            far_enough = min(far_enough, max(apart.values()))
        ends = [cell for cell, moves in apart.items() if moves >= far_enough]
        return [ends[choice] for choice in self.rng.permutation(len(ends))]


def sample_labyrinth(
    height: int,
    width: int,
    task: Task,
    rng: np.random.Generator,
    *,
    start: int | None = None,
    goal: int | None = None,
    algorithm: str = "wilson",
    open_walls: float | None = None,
    allows: Callable[[Structure], bool] | None = None,
) -> Labyrinth:
    """Return a random labyrinth, redrawing structures that cannot hold the task.

    Args:
        height: Rows.
        width: Columns.
        task: The task to hold.
        rng: The source of all randomness.
        start: Cell of the start, None for the bottom left.
        goal: Cell of the goal, None for the top right.
        algorithm: How the spanning tree is drawn, as for `Structure.sample`.
        open_walls: Probability of opening each wall that the tree leaves, None for about 0.1.
        allows: Returns whether a structure may be used; None allows all.

    Raises:
        LabyrinthError: None of the structures drawn can hold the task, or no structure can.
        ValueError: A number is not an integer or out of bounds, start and goal are the same cell,
            or the task or the algorithm is unknown.
    """
    height, width = checked_sides(height, width)
    if task not in [*Task]:
        raise ValueError(f"task={task}: choose one of {', '.join(Task)}")
    task = Task(task)
    last = height * width - 1
    start = 0 if start is None else whole("start", start, 0, last)
    goal = last if goal is None else whole("goal", goal, 0, last)
    wish = f"size={height}x{width}, {_wish_text(task, start, goal, width)}"
    _check_apart(start, goal, wish)
    if open_walls is not None:
        task.check_open_walls(open_walls)
    structures = Structure.sample(height, width, rng, algorithm=algorithm, open_walls=open_walls)
    try:
        return next(Placer(rng).labyrinths(structures, task, (start, goal), allows))
    except LabyrinthError as error:
        raise LabyrinthError(
            f"{wish}: none of {MAX_DRAWS:,} random labyrinths fits; "
            "change size, task, start or goal"
        ) from error


def _wish_text(task: Task, start: int, goal: int, width: int) -> str:
    """Return task, start and goal in words, for error messages."""
    return f"task={task}, start={divmod(start, width)}, goal={divmod(goal, width)}"


def _check_apart(start: int, goal: int, wish: str) -> None:
    """Raise ValueError if start and goal are the same cell."""
    if start == goal:
        raise ValueError(f"{wish}: start and goal must be two different cells")

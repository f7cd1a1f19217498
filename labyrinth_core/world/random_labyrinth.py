"""Random labyrinths that hold a task, and labyrinths with another start or goal."""

from __future__ import annotations

from contextlib import suppress
from itertools import islice

import numpy as np

from labyrinth_core.world.grid import checked_sides, manhattan, whole
from labyrinth_core.world.labyrinth import Labyrinth, LabyrinthError, Structure, Task
from labyrinth_core.world.sampling import sample_structures
from labyrinth_core.world.tasks import check_open_walls, default_start_and_goal, place

MAX_DRAWS = 10_000
"""The structures to draw before giving up; hundreds are plenty where any can hold the task."""


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
) -> Labyrinth:
    """Return a random labyrinth; structures that cannot hold the task are drawn again.

    Args:
        height: Rows.
        width: Columns.
        task: The task to hold.
        rng: The source of all randomness.
        start: Cell of the start, None for the bottom left.
        goal: Cell of the goal, None for the top right.
        algorithm: How the spanning tree is drawn, as for `sampling.sample_structures`.
        open_walls: Probability of opening each wall that the tree leaves.

    Raises:
        LabyrinthError: No structure that was drawn can hold the task, or none can.
        ValueError: A number is not whole or out of bounds, start and goal are the same cell, or the
            task or the algorithm is unknown.
    """
    height, width = checked_sides(height, width)
    if task not in [*Task]:
        raise ValueError(f"task={task}: choose one of {', '.join(Task)}")
    default_start, default_goal = default_start_and_goal(height, width)
    last = height * width - 1
    start = default_start if start is None else whole("start", start, 0, last)
    goal = default_goal if goal is None else whole("goal", goal, 0, last)
    wish = f"size={height}x{width}, {wish_text(task, start, goal, width)}"
    check_apart(start, goal, wish)
    if open_walls is not None:
        check_open_walls(task, open_walls)
    structures = sample_structures(height, width, rng, algorithm=algorithm, open_walls=open_walls)
    for structure in islice(structures, MAX_DRAWS):
        try:
            return place(structure, start, goal, task, rng)
        except LabyrinthError:
            continue
    raise LabyrinthError(
        f"{wish}: none of {MAX_DRAWS:,} labyrinths can hold it; change one of them"
    )


def wish_text(task: Task, start: int, goal: int, width: int) -> str:
    """Return task, start and goal as a message names them."""
    return f"task={task}, start={divmod(start, width)}, goal={divmod(goal, width)}"


def check_apart(start: int, goal: int, wish: str) -> None:
    """Raise ValueError if start and goal are the same cell."""
    if start == goal:
        raise ValueError(f"{wish}: start and goal must be two different cells")


def draw_start_and_goal(structure: Structure, task: Task, rng: np.random.Generator) -> Labyrinth:
    """Return a labyrinth with start and goal drawn at random, far enough apart, and its tiles.

    Far enough is `(width + height) // 2` moves on a grid without walls. The goal is drawn first,
    uniformly, and then the start, uniformly among the cells that are far enough from the goal;
    where the two cannot hold the task, others are drawn.

    Raises:
        LabyrinthError: No start and goal can hold the task.
    """
    goals = rng.permutation(structure.cells).tolist()
    if task is Task.ICY_FLOOR and not structure.loops:
        goals = []  # Each cell has one way to it; trying all pairs takes long.
    return _moved(structure, task, goals, rng)


def change_start(labyrinth: Labyrinth, rng: np.random.Generator) -> Labyrinth:
    """Return the labyrinth with another start, far enough from the goal, and its tiles placed anew.

    Far enough is `(width + height) // 2` moves on a grid without walls, or as far as any other
    start can be.

    Raises:
        LabyrinthError: No other start can hold the task.
    """
    return _moved(labyrinth.structure, labyrinth.task, [labyrinth.goal], rng, former=labyrinth)


def change_goal(labyrinth: Labyrinth, rng: np.random.Generator) -> Labyrinth:
    """Return the labyrinth with another goal, far enough from the start, and its tiles placed anew.

    Far enough is as for `change_start`.

    Raises:
        LabyrinthError: No other goal can hold the task.
    """
    for goal in _ends(labyrinth.structure, labyrinth.start, labyrinth.goal, rng, nearer=True):
        with suppress(LabyrinthError):
            return place(labyrinth.structure, labyrinth.start, goal, labyrinth.task, rng)
    raise LabyrinthError(f"no other goal can hold {labyrinth.task}")


def change_start_and_goal(labyrinth: Labyrinth, rng: np.random.Generator) -> Labyrinth:
    """Return the labyrinth with another start and another goal; otherwise as `change_start`."""
    goals = rng.permutation(labyrinth.structure.cells).tolist()
    goals.remove(labyrinth.goal)
    return _moved(labyrinth.structure, labyrinth.task, goals, rng, former=labyrinth)


def _moved(
    structure: Structure,
    task: Task,
    goals: list[int],
    rng: np.random.Generator,
    former: Labyrinth | None = None,
) -> Labyrinth:
    """Return the labyrinth with the first of the goals, and a start, that hold the task.

    The start differs from that of `former`; where the goal is the same, it may be nearer to the
    goal than is far enough.
    """
    former_start, former_goal = (former.start, former.goal) if former is not None else (None, None)
    for goal in goals:
        for start in _ends(structure, goal, former_start, rng, nearer=goal == former_goal):
            with suppress(LabyrinthError):
                return place(structure, start, goal, task, rng)
    other = "" if former is None else "other "
    raise LabyrinthError(f"no {other}start or goal can hold {task}")


def _ends(
    structure: Structure, other: int, former: int | None, rng: np.random.Generator, *, nearer: bool
) -> list[int]:
    """Return the cells that start or goal may move to, in random order.

    Args:
        structure: The structure.
        other: The cell of the other one of the two, which has to be far enough away.
        former: The cell that is left; None if every cell may be taken.
        rng: Draws the order.
        nearer: Whether the farthest cells are accepted where no cell is far enough.
    """
    apart = {
        cell: manhattan(cell, other, structure.width)
        for cell in range(structure.cells)
        if cell not in (other, former)
    }
    far_enough = (structure.height + structure.width) // 2
    if nearer:
        far_enough = min(far_enough, max(apart.values()))
    ends = [cell for cell, moves in apart.items() if moves >= far_enough]
    return [ends[choice] for choice in rng.permutation(len(ends))]

"""A random labyrinth that holds a task."""

from __future__ import annotations

from itertools import islice

import numpy as np

from labyrinth_core.world.labyrinth import Labyrinth, LabyrinthError, Task
from labyrinth_core.world.sampling import sample_structures
from labyrinth_core.world.tasks import check_open_walls, default_start_and_goal, place

MAX_DRAWS = 10_000
"""Structures drawn before giving up; where a task can be held at all, hundreds are plenty."""


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
        rng: Where all randomness comes from.
        start: Cell of the start, None for the bottom left.
        goal: Cell of the goal, None for the top right.
        algorithm: As in `sampling.sample_structures`, and so is `open_walls`.
        open_walls: Probability of opening each wall that the tree leaves.

    Raises:
        LabyrinthError: No structure drawn can hold the task, or none ever could.
        ValueError: Start and goal are the same cell, or there is no such algorithm.
    """
    default_start, default_goal = default_start_and_goal(height, width)
    start = default_start if start is None else start
    goal = default_goal if goal is None else goal
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

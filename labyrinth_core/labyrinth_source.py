"""Which labyrinth the next episode of an environment is about."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import islice
from operator import index
from pathlib import Path

import numpy as np

from labyrinth_core.grid import cell_at, parse_size, row_and_column
from labyrinth_core.labyrinth import Labyrinth, LabyrinthError, Structure, Task
from labyrinth_core.language import load, parse
from labyrinth_core.sampling import sample_structures
from labyrinth_core.tasks import default_start_and_goal, place

MAX_DRAWS = 10_000
"""Structures drawn before giving up; where a task can be held at all, hundreds are plenty."""
OPTIONS = ("labyrinth", "task", "start", "goal")
"""What can be changed for one episode."""

Size = int | str | tuple[int, int]
LabyrinthLike = Labyrinth | str | Path


def as_size(size: Size) -> tuple[int, int]:
    """Return `(height, width)` of a size given as `5`, `"4x6"` or `(4, 6)`.

    Raises:
        ValueError: It is none of these, or too small or too large.
    """
    return parse_size("x".join(map(str, size)) if isinstance(size, (tuple, list)) else str(size))


def as_task(task: Task | str) -> Task:
    """Return the task with a name.

    Raises:
        ValueError: There is none.
    """
    try:
        return Task(task)
    except ValueError as error:
        raise ValueError(f"task={task}: choose one of {', '.join(Task)}") from error


def as_labyrinth(labyrinth: LabyrinthLike) -> Labyrinth:
    """Return a labyrinth given as such, as its text, or as the path of a file.

    A string without a line break is a path. Tiles that a text leaves out are always placed in
    the same way.

    Raises:
        ValueError: It is none of these, the text is no labyrinth, or the file cannot be read.
    """
    if isinstance(labyrinth, Labyrinth):
        return labyrinth
    if isinstance(labyrinth, str) and "\n" in labyrinth:
        return parse(labyrinth)
    if isinstance(labyrinth, (str, Path)):
        try:
            return load(Path(labyrinth))
        except OSError as error:
            raise ValueError(f"labyrinth={labyrinth}: {error.strerror}") from error
    raise ValueError(f"labyrinth={labyrinth!r}: give a Labyrinth, its text, or the path of a file")


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
        LabyrinthError: No structure drawn can hold the task.
        ValueError: Start and goal are the same cell, or there is no such algorithm.
    """
    default_start, default_goal = default_start_and_goal(height, width)
    start = default_start if start is None else start
    goal = default_goal if goal is None else goal
    wish = f"size={height}x{width}, {_wish(task, start, goal, width)}"
    _check_apart(start, goal, wish)
    structures = sample_structures(height, width, rng, algorithm=algorithm, open_walls=open_walls)
    for structure in islice(structures, MAX_DRAWS):
        try:
            return place(structure, start, goal, task, rng)
        except LabyrinthError:
            continue
    raise LabyrinthError(
        f"{wish}: none of {MAX_DRAWS:,} labyrinths can hold it; change one of them"
    )


@dataclass(frozen=True)
class LabyrinthSource:
    """Where an environment's labyrinths come from."""

    height: int
    width: int
    task: Task
    kept: Labyrinth | None = None
    """The labyrinth of every episode; None for a fresh one each time."""

    @classmethod
    def of(cls, size: Size, task: Task | str, kept: LabyrinthLike | None) -> LabyrinthSource:
        """Return the source of labyrinths of a size and task, or of one that is kept.

        Raises:
            ValueError: One of them makes no sense.
        """
        if kept is None:
            return cls(*as_size(size), as_task(task))
        labyrinth = as_labyrinth(kept)
        structure = labyrinth.structure
        return cls(structure.height, structure.width, labyrinth.task, labyrinth)

    def draw(
        self, rng: np.random.Generator, options: Mapping[str, object] | None = None
    ) -> Labyrinth:
        """Return the labyrinth of the next episode.

        Another task, start or goal than the labyrinth has means that its task's tiles are placed
        anew, by the rules of the sampler.

        Args:
            rng: Where all randomness comes from.
            options: For this episode only, `labyrinth` (as such, its text, or a path), `task`,
                `start` and `goal` (each `(row, column)`).

        Raises:
            ValueError: An option has no such name, or a value that is impossible.
        """
        options = {name: value for name, value in (options or {}).items() if value is not None}
        for name in options:
            if name not in OPTIONS:
                raise ValueError(f"option {name!r}: choose among {', '.join(OPTIONS)}")
        labyrinth = as_labyrinth(options["labyrinth"]) if "labyrinth" in options else self.kept  # type: ignore[arg-type]
        structure = labyrinth.structure if labyrinth else None
        height = structure.height if structure else self.height
        width = structure.width if structure else self.width
        task = as_task(options["task"]) if "task" in options else None  # type: ignore[arg-type]
        start, goal = (
            _as_cell(name, options[name], height, width) if name in options else None
            for name in ("start", "goal")
        )
        if labyrinth is None:
            return sample_labyrinth(height, width, task or self.task, rng, start=start, goal=goal)
        return _change(labyrinth, task, start, goal, rng)


def _change(
    labyrinth: Labyrinth,
    task: Task | None,
    start: int | None,
    goal: int | None,
    rng: np.random.Generator,
) -> Labyrinth:
    """Return the labyrinth with another task, start or goal, as far as they are given."""
    task = labyrinth.task if task is None else task
    start = labyrinth.start if start is None else start
    goal = labyrinth.goal if goal is None else goal
    if (task, start, goal) == (labyrinth.task, labyrinth.start, labyrinth.goal):
        return labyrinth
    structure: Structure = labyrinth.structure
    wish = _wish(task, start, goal, structure.width)
    _check_apart(start, goal, wish)
    try:
        return place(structure, start, goal, task, rng)
    except LabyrinthError as error:
        raise ValueError(f"{wish}: this labyrinth cannot hold it; {error}") from error


def _wish(task: Task, start: int, goal: int, width: int) -> str:
    return f"task={task}, start={row_and_column(start, width)}, goal={row_and_column(goal, width)}"


def _check_apart(start: int, goal: int, wish: str) -> None:
    if start == goal:
        raise ValueError(f"{wish}: start and goal must be two different cells")


def _as_cell(name: str, value: object, height: int, width: int) -> int:
    """Return the cell at a `(row, column)`."""
    try:
        row, column = (index(number) for number in value)  # type: ignore[attr-defined]
        if 0 <= row < height and 0 <= column < width:
            return cell_at(row, column, width)
    except (TypeError, ValueError):
        pass
    raise ValueError(
        f"{name}={value!r}: give (row, column), rows from 0 (bottom) to {height - 1}, "
        f"columns from 0 (left) to {width - 1}"
    )

"""Which labyrinth the next episode of an environment is about."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from operator import index
from pathlib import Path

import numpy as np

from labyrinth_core.language.text import load, parse
from labyrinth_core.world.grid import cell_at, parse_size
from labyrinth_core.world.labyrinth import Labyrinth, LabyrinthError, Structure, Task
from labyrinth_core.world.random_labyrinth import check_apart, sample_labyrinth, wish_text
from labyrinth_core.world.tasks import place

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
    wish = wish_text(task, start, goal, structure.width)
    check_apart(start, goal, wish)
    try:
        return place(structure, start, goal, task, rng)
    except LabyrinthError as error:
        raise ValueError(f"{wish}: this labyrinth cannot hold it; {error}") from error


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

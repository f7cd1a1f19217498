"""The source of an environment's labyrinths, and the values that its arguments may have."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from operator import index
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np

from labyrinth_core.language.text import load, parse
from labyrinth_core.world.dynamics import STEP_LIMIT
from labyrinth_core.world.grid import parse_size
from labyrinth_core.world.labyrinth import Labyrinth, LabyrinthError, Task
from labyrinth_core.world.random_labyrinth import check_apart, sample_labyrinth, wish_text
from labyrinth_core.world.tasks import place

Choice = TypeVar("Choice")
Size = int | str | tuple[int, int]
LabyrinthLike = Labyrinth | str | Path

OPTIONS = ("labyrinth", "task", "start", "goal")
"""The options of a reset that change the labyrinth of one episode."""


class Shape(NamedTuple):
    """The properties of a labyrinth on which its observation space depends."""

    height: int
    width: int
    task: Task

    @classmethod
    def of(cls, labyrinth: Labyrinth) -> Shape:
        """Return the shape of a labyrinth."""
        return cls(labyrinth.structure.height, labyrinth.structure.width, labyrinth.task)


class LabyrinthSource(NamedTuple):
    """Where an environment's labyrinths come from."""

    shape: Shape
    kept: Labyrinth | None = None
    """The labyrinth of every episode; None to sample one for each."""

    @classmethod
    def of(cls, size: Size, task: Task | str, kept: LabyrinthLike | None) -> LabyrinthSource:
        """Return the source of labyrinths of a size and task, or of one that is kept.

        Raises:
            ValueError: An argument has a value that is impossible.
        """
        if kept is None:
            written = "x".join(map(str, size)) if isinstance(size, (tuple, list)) else str(size)
            return cls(Shape(*parse_size(written), chosen("task", task, Task)))
        labyrinth = as_labyrinth(kept)
        return cls(Shape.of(labyrinth), labyrinth)

    def draw(self, rng: np.random.Generator, options: Mapping[str, Any] | None = None) -> Labyrinth:
        """Return the labyrinth of the next episode, with the options of `LabyrinthEnv.reset`.

        Raises:
            ValueError: An option has no such name, or a value that is impossible.
        """
        options = {name: value for name, value in (options or {}).items() if value is not None}
        for name in options:
            if name not in OPTIONS:
                raise ValueError(f"option {name!r}: choose among {', '.join(OPTIONS)}")
        labyrinth = as_labyrinth(options["labyrinth"]) if "labyrinth" in options else self.kept
        height, width, task = self.shape if labyrinth is None else Shape.of(labyrinth)
        if "task" in options:
            task = chosen("task", options["task"], Task)
        start, goal = (
            _as_cell(name, options[name], height, width) if name in options else None
            for name in ("start", "goal")
        )
        if labyrinth is None:
            return sample_labyrinth(height, width, task, rng, start=start, goal=goal)
        start = labyrinth.start if start is None else start
        goal = labyrinth.goal if goal is None else goal
        if (task, start, goal) == (labyrinth.task, labyrinth.start, labyrinth.goal):
            return labyrinth
        wish = wish_text(task, start, goal, width)
        check_apart(start, goal, wish)
        try:
            return place(labyrinth.structure, start, goal, task, rng)
        except LabyrinthError as error:
            raise ValueError(f"{wish}: this labyrinth cannot hold it; {error}") from error


def _as_cell(name: str, value: Any, height: int, width: int) -> int:
    """Return the cell at a `(row, column)`."""
    try:
        row, column = map(index, value)
        if 0 <= row < height and 0 <= column < width:
            return row * width + column
    except (TypeError, ValueError):
        pass
    raise ValueError(
        f"{name}={value!r}: give (row, column), rows from 0 (bottom) to {height - 1}, "
        f"columns from 0 (left) to {width - 1}"
    )


def chosen(name: str, value: object, choices: Iterable[Choice]) -> Choice:
    """Return the choice that an argument names, by itself or by the value of an enum's member.

    Raises:
        ValueError: It names none of them.
    """
    for choice in choices:
        if value in (choice, getattr(choice, "value", choice)):
            return choice
    names = ", ".join(str(getattr(choice, "value", choice)) for choice in choices)
    raise ValueError(f"{name}={value}: choose one of {names}")


def as_labyrinth(labyrinth: LabyrinthLike) -> Labyrinth:
    """Return a labyrinth given as such, as its text, or as the path of a file.

    A string without a line break is a path. Tiles that a text leaves out are always placed in
    the same way.

    Raises:
        ValueError: It has another type, the text is not a labyrinth, or the file cannot be read.
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


def step_limit(cells: int, max_episode_steps: int | None) -> int:
    """Return the number of steps after which an episode in a labyrinth is truncated.

    Raises:
        ValueError: `max_episode_steps`, a limit that may be lower, is no whole number from 1 on.
    """
    if max_episode_steps is None:
        return STEP_LIMIT * cells
    if not isinstance(max_episode_steps, int | np.integer) or max_episode_steps < 1:
        raise ValueError(f"max_episode_steps={max_episode_steps}: give a whole number from 1 on")
    return min(STEP_LIMIT * cells, int(max_episode_steps))

"""The source of an environment's labyrinths: one for each episode."""

from __future__ import annotations

from collections.abc import Mapping
from operator import index
from typing import Any, NamedTuple

import numpy as np

from labyrinth_core.env.arguments import LabyrinthLike, Size, as_labyrinth, as_size, chosen
from labyrinth_core.world.grid import cell_at
from labyrinth_core.world.labyrinth import Labyrinth, LabyrinthError, Task
from labyrinth_core.world.random_labyrinth import check_apart, sample_labyrinth, wish_text
from labyrinth_core.world.tasks import place

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
            return cls(Shape(*as_size(size), chosen("task", task, Task)))
        labyrinth = as_labyrinth(kept)
        return cls(Shape.of(labyrinth), labyrinth)

    def draw(self, rng: np.random.Generator, options: Mapping[str, Any] | None = None) -> Labyrinth:
        """Return the labyrinth of the next episode.

        If task, start or goal differ from those of a given labyrinth, the tiles of the task are
        placed anew by the rules of the sampler.

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
            return cell_at(row, column, width)
    except (TypeError, ValueError):
        pass
    raise ValueError(
        f"{name}={value!r}: give (row, column), rows from 0 (bottom) to {height - 1}, "
        f"columns from 0 (left) to {width - 1}"
    )

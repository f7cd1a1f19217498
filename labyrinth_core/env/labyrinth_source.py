"""Where an environment's labyrinths come from, and the checks of its arguments."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from copy import copy
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np
from gymnasium.envs.registration import EnvSpec
from numpy.typing import NDArray

from labyrinth_core.checks import whole
from labyrinth_core.language import dump, load, parse, parse_size
from labyrinth_core.world import (
    BUCKETS,
    RULES,
    Labyrinth,
    LabyrinthError,
    Placer,
    Structure,
    Task,
    sample_labyrinth,
)

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
    split: str | None = None
    """The split whose structures are sampled, one of `BUCKETS._fields`; None for all structures."""
    buckets: tuple[int, ...] = BUCKETS
    """The percentages of all structures in the three splits."""

    def plainly(self) -> dict[str, Any]:
        """Return the arguments that recreate this source, as strings."""
        height, width, task = self.shape
        labyrinth = None if self.kept is None else dump(self.kept)
        return {
            "size": f"{height}x{width}",
            "task": str(task),
            "labyrinth": labyrinth,
            "split": self.split,
            "buckets": list(self.buckets),
        }

    @classmethod
    def of(
        cls,
        size: Size,
        task: Task | str,
        kept: LabyrinthLike | None,
        split: str | None = None,
        buckets: Sequence[int] = BUCKETS,
    ) -> LabyrinthSource:
        """Return the source of random labyrinths of a size and task, or of a fixed labyrinth.

        Raises:
            ValueError: An argument has a value that is not allowed.
        """
        if split is not None:
            split = chosen("split", split, BUCKETS._fields)
        shares = checked_buckets(buckets)
        if kept is None:
            written = "x".join(map(str, size)) if isinstance(size, (tuple, list)) else str(size)
            shape = Shape(*parse_size(written), chosen("task", task, Task))
            return cls(shape, None, split, shares)
        if split is not None:
            raise ValueError(f"split={split}: give a split or fixed labyrinths, not both")
        labyrinth = as_labyrinth(kept)
        return cls(Shape.of(labyrinth), labyrinth)

    def draw(self, rng: np.random.Generator, options: Mapping[str, Any] | None = None) -> Labyrinth:
        """Return the labyrinth of the next episode, with the options of `LabyrinthEnv.reset`.

        Raises:
            ValueError: An option is unknown, or has a value that is not allowed.
        """
        options = {name: value for name, value in (options or {}).items() if value is not None}
        for name in options:
            if name not in OPTIONS:
                raise ValueError(
                    f"option {name!r}: choose among {', '.join(OPTIONS)}; max_episode_steps is for "
                    "a single environment, reset_mask for a vector environment"
                )
        labyrinth = as_labyrinth(options["labyrinth"]) if "labyrinth" in options else self.kept
        height, width, task = self.shape if labyrinth is None else Shape.of(labyrinth)
        if "task" in options:
            task = chosen("task", options["task"], Task)
        start, goal = (
            _as_cell(name, options[name], height, width) if name in options else None
            for name in ("start", "goal")
        )
        if labyrinth is None:
            if self.split is None:
                return sample_labyrinth(height, width, task, rng, start=start, goal=goal)
            at_any_ends = start is not None or goal is not None
            bucket = Structure.split_at_any_ends if at_any_ends else Structure.split
            try:
                return sample_labyrinth(
                    height,
                    width,
                    task,
                    rng,
                    start=start,
                    goal=goal,
                    allows=lambda structure: bucket(structure, self.buckets) == self.split,
                )
            except LabyrinthError as error:
                raise LabyrinthError(f"split={self.split}: {error}") from error
        start = labyrinth.start if start is None else start
        goal = labyrinth.goal if goal is None else goal
        return Placer(rng).changed(labyrinth, task, start, goal)


def sources_of(
    size: Size,
    task: Task | str,
    labyrinth: LabyrinthLike | None,
    labyrinths: Iterable[LabyrinthLike] | None,
    split: str | None,
    buckets: Sequence[int],
) -> list[LabyrinthSource]:
    """Return the sources that episodes take in turn: one, or one for each of `labyrinths`.

    Raises:
        ValueError: An argument has a value that is not allowed.
    """
    if labyrinths is None:
        return [LabyrinthSource.of(size, task, labyrinth, split, buckets)]
    if labyrinth is not None:
        raise ValueError("give labyrinth or labyrinths, not both")
    if isinstance(labyrinths, LabyrinthLike):
        raise ValueError("labyrinths: give a list, or labyrinth=... for one")
    given = map(as_labyrinth, labyrinths)
    sources = [LabyrinthSource.of(size, task, each, split, buckets) for each in given]
    if not sources:
        raise ValueError("labyrinths: give at least one")
    for source in sources:
        if source.kept is not None:
            check_shape(source.kept, sources[0].shape)
    return sources


def check_shape(labyrinth: Labyrinth, shape: Shape) -> None:
    """Raise ValueError if a labyrinth does not have the shape of the others of its environment."""
    if Shape.of(labyrinth) != shape:
        raise ValueError(
            f"all labyrinths of an environment have one size and task: here "
            f"{shape.height}x{shape.width} and {shape.task}, "
            f"not {labyrinth.size_name} and {labyrinth.task}"
        )


def _as_cell(name: str, value: Any, height: int, width: int) -> int:
    """Return the cell at a `(row, column)`."""
    try:
        row, column = value
        return whole("row", row, 0, height - 1) * width + whole("column", column, 0, width - 1)
    except (TypeError, ValueError) as error:
        raise ValueError(
            f"{name}={value!r}: give (row, column), rows from 0 (bottom) to {height - 1}, "
            f"columns from 0 (left) to {width - 1}"
        ) from error


def chosen(name: str, value: object, choices: Iterable[Choice]) -> Choice:
    """Return the choice that equals `value`, or the enum member whose value equals it.

    Raises:
        ValueError: No choice matches.
    """
    for choice in choices:
        if value in (choice, getattr(choice, "value", choice)):
            return choice
    names = ", ".join(str(getattr(choice, "value", choice)) for choice in choices)
    raise ValueError(f"{name}={value}: choose one of {names}")


def checked_buckets(buckets: Sequence[int]) -> tuple[int, ...]:
    """Return three percentages as a tuple; raise ValueError if they are not allowed."""
    try:
        shares = tuple(whole("buckets", each, 1, 98) for each in buckets)
    except (TypeError, ValueError):
        shares = ()
    if len(shares) != len(BUCKETS) or sum(shares) != 100:
        raise ValueError(
            f"buckets={buckets!r}: give three percentages of 1 or more that add up to 100"
        )
    return shares


def as_labyrinth(labyrinth: LabyrinthLike) -> Labyrinth:
    """Return a labyrinth given as a `Labyrinth`, as its text, or as the path of a file.

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


def checked_seeds(seed: object, num_envs: int) -> list[int | None]:
    """Return the seed of each sub-environment, given a sequence of seeds, the first one, or None.

    Raises:
        ValueError: A seed is not a non-negative integer, or there are too few or too many seeds.
    """
    if seed is None:
        return [None] * num_envs
    if not isinstance(seed, (Sequence, np.ndarray)):
        first = whole("seed", seed, 0)
        return [*range(first, first + num_envs)]
    if len(seed) != num_envs:
        raise ValueError(f"seed: give one, or {num_envs} of them, not {len(seed)}")
    return [None if each is None else whole("seed", each, 0) for each in seed]


def checked_mask(mask: object, num_envs: int) -> NDArray[np.bool_]:
    """Return a copy of the mask of sub-environments that begin an episode; None selects all.

    Raises:
        ValueError: The mask is not a boolean array with an entry for each, or selects none.
    """
    shape = (num_envs,)
    if mask is None:
        return np.ones(shape, np.bool_)
    if not (isinstance(mask, np.ndarray) and mask.dtype == np.bool_ and mask.shape == shape):
        raise ValueError(f"option 'reset_mask': give a bool array of shape {shape}, not {mask!r}")
    if not mask.any():
        raise ValueError("option 'reset_mask': at least one entry must be True")
    return np.array(mask)


def step_limit(cells: int, max_episode_steps: int | None) -> int:
    """Return the number of steps after which an episode in a labyrinth is truncated.

    Raises:
        ValueError: `max_episode_steps`, which can lower the limit, is not a positive integer.
    """
    if max_episode_steps is None:
        return RULES.step_limit * cells
    return min(RULES.step_limit * cells, whole("max_episode_steps", max_episode_steps, 1))


def write_plainly(spec: EnvSpec | None, values: Mapping[str, Any], limit: int) -> EnvSpec | None:
    """Return an environment's specification with plain values, which can be written as JSON.

    Args:
        spec: The specification that Gymnasium made.
        values: The values of arguments by name, as Python strings and numbers.
        limit: The number of steps after which an episode is truncated.
    """
    if spec is None:
        return None
    plain = copy(spec)
    given = {name: value for name, value in values.items() if name in spec.kwargs}
    plain.kwargs, plain.max_episode_steps = spec.kwargs | given, limit
    return plain

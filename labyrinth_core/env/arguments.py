"""The values that the environments' arguments may have."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TypeVar

from labyrinth_core.language.text import load, parse
from labyrinth_core.world.dynamics import STEP_LIMIT
from labyrinth_core.world.grid import parse_size
from labyrinth_core.world.labyrinth import Labyrinth

Choice = TypeVar("Choice")
Size = int | str | tuple[int, int]
LabyrinthLike = Labyrinth | str | Path


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


def as_size(size: Size) -> tuple[int, int]:
    """Return `(height, width)` of a size given as `5`, `"4x6"` or `(4, 6)`.

    Raises:
        ValueError: It is none of these, or too small or too large.
    """
    return parse_size("x".join(map(str, size)) if isinstance(size, (tuple, list)) else str(size))


def as_labyrinth(labyrinth: LabyrinthLike) -> Labyrinth:
    """Return a labyrinth given as such, as its text, or as the path of a file.

    A string without a line break is a path. Tiles that a text leaves out are always placed in
    the same way.

    Raises:
        ValueError: It is none of these, the text is not a labyrinth, or the file cannot be read.
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
    """Return the number of steps after which an episode is truncated.

    Args:
        cells: The number of cells of the labyrinth.
        max_episode_steps: A lower limit than the labyrinth's own, or None.

    Raises:
        ValueError: `max_episode_steps` is below 1.
    """
    if max_episode_steps is None:
        return STEP_LIMIT * cells
    if max_episode_steps < 1:
        raise ValueError(f"max_episode_steps={max_episode_steps}: give a whole number from 1 on")
    return min(STEP_LIMIT * cells, max_episode_steps)

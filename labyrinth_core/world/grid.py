"""The cells of a grid, the actions, and sets of cells.

A cell is an integer, `row * width + column`; row 0 is at the bottom and column 0 at the left. A bit
set over cells is an integer whose bit `c`, counted from the lowest, stands for cell `c`.
"""

from __future__ import annotations

import re
from contextlib import suppress
from enum import IntEnum
from math import inf
from numbers import Integral
from operator import index

MIN_SIDE = 2
MAX_SIDE = 1_000
"""The largest height and width; it limits the time and memory that a stranger's text can take."""


class Action(IntEnum):
    """The four moves of an agent; `UP` increases the row, and is up in the picture."""

    UP = 0
    RIGHT = 1
    DOWN = 2
    LEFT = 3


def manhattan(a: int, b: int, width: int) -> int:
    """Return the number of moves between two cells of a grid without walls."""
    (row_a, column_a), (row_b, column_b) = divmod(a, width), divmod(b, width)
    return abs(row_a - row_b) + abs(column_a - column_b)


def neighbours(cell: int, height: int, width: int) -> dict[Action, int]:
    """Return the neighbours of `cell`, by the action that leads there unless walled off."""
    row, column = divmod(cell, width)
    beside = {}
    if row + 1 < height:
        beside[Action.UP] = cell + width
    if column + 1 < width:
        beside[Action.RIGHT] = cell + 1
    if row > 0:
        beside[Action.DOWN] = cell - width
    if column > 0:
        beside[Action.LEFT] = cell - 1
    return beside


def digits(bits: int, cells: int) -> str:
    """Return a bit set as text: a digit 1 for each cell in it, a 0 for each other, in order."""
    return f"{bits:0{cells}b}"[::-1]


def bit_set(digits: str) -> int:
    """Return the bit set that a text of digits describes; the inverse of `digits`."""
    return int(digits[::-1], 2)


def vertical_edges(height: int, width: int) -> int:
    """Return the bit set of the cells with a neighbour above: all but the top row."""
    return (1 << (height - 1) * width) - 1


def horizontal_edges(height: int, width: int) -> int:
    """Return the bit set of the cells with a neighbour at the right: all but the last column."""
    row = (1 << width - 1) - 1
    return row * (((1 << height * width) - 1) // ((1 << width) - 1))


def whole(
    name: str, value: object, least: float = -inf, most: float = inf, *, allowed: str = ""
) -> int:
    """Return a whole number of Python's or NumPy's as one of Python's, which cannot overflow.

    Args:
        name: The name of the argument, for the message.
        value: Its value.
        least: The smallest number that is allowed.
        most: The largest.
        allowed: What is allowed, in words, if that is more than the numbers between these.

    Raises:
        ValueError: The value is of another type, such as `bool`, or out of bounds.
    """
    number = value if type(value) is int else None
    if number is None and isinstance(value, Integral) and not isinstance(value, bool):
        with suppress(TypeError):  # NumPy has lengths of time as whole numbers, too.
            number = index(value)
    if number is not None and least <= number <= most:
        return number
    bounds = f" from {least} on" if most == inf else f" from {least} to {most}"
    allowed = allowed or f"a whole number{'' if least == -inf else bounds}"
    raise ValueError(f"{name}={value!r:.60}: give {allowed}")


def checked_sides(height: object, width: object) -> tuple[int, int]:
    """Return the rows and the columns of a labyrinth as numbers of Python's.

    Raises:
        ValueError: One of them is not a whole number from 2 to 1,000.
    """
    return whole("height", height, MIN_SIDE, MAX_SIDE), whole("width", width, MIN_SIDE, MAX_SIDE)


def parse_size(text: str) -> tuple[int, int]:
    """Return `(height, width)` of a size written as `5` or `4x6`.

    Raises:
        ValueError: The text is not a whole number from 2 to 1,000, or two joined by an x.
    """
    match = re.fullmatch(r"\s*(\d{1,5})(?:\s*[xX]\s*(\d{1,5}))?\s*", text, re.ASCII)
    sides = (int(match[1]), int(match[2] or match[1])) if match else (0, 0)
    if not all(MIN_SIDE <= side <= MAX_SIDE for side in sides):
        raise ValueError(
            f"size={text}: give a whole number from {MIN_SIDE} to {MAX_SIDE:,} such as 5, "
            "or height x width such as 4x6"
        )
    return sides

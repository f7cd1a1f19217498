"""The cells of a grid: sizes allowed, bit sets over cells, and neighbours regardless of walls."""

from __future__ import annotations

from labyrinth_core.checks import whole
from labyrinth_core.world.rules import Action

SIDES = range(2, 1_001)
"""The heights and widths allowed; the largest limits the time and memory that text can cost."""
_LEAST, _MOST = SIDES[0], SIDES[-1]


def digits(bits: int, cells: int) -> str:
    """Return a bit set as text, a digit per cell in order: 1 if the cell is in the set, else 0."""
    return f"{bits:0{cells}b}"[::-1]


def bit_set(digits: str) -> int:
    """Return the bit set that a string of digits 0 and 1 describes; the inverse of `digits`."""
    return int(digits[::-1], 2)


def vertical_edges(height: int, width: int) -> int:
    """Return the bit set of the cells with a neighbour above: all but the top row."""
    return (1 << (height - 1) * width) - 1


def horizontal_edges(height: int, width: int) -> int:
    """Return the bit set of the cells with a neighbour to the right: all but the last column."""
    row = (1 << width - 1) - 1
    return row * (((1 << height * width) - 1) // ((1 << width) - 1))


def checked_sides(height: object, width: object) -> tuple[int, int]:
    """Return the height and width of a labyrinth as Python ints.

    Raises:
        ValueError: One of them is not an integer from 2 to 1,000.
    """
    return whole("height", height, _LEAST, _MOST), whole("width", width, _LEAST, _MOST)


def neighbours(cell: int, height: int, width: int) -> dict[Action, int]:
    """Return the neighbours of `cell` in the grid by action, regardless of walls."""
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

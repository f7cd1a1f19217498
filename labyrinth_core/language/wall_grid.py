"""Labyrinths as wall grids: arrays in which the walls, too, have elements of their own.

A labyrinth of h rows and w columns is an array of 2h + 1 rows and 2w + 1 columns, the top row
first. A cell is where row and column are odd, a passage or a wall between two cells where one of
them is, and everything else is wall: the outer wall, and the points where four cells meet. Walls
are 1 and the rest is 0, or the other way round: the corner, which is always wall, tells. A 2 marks
the cell of the start, a 3 that of the goal. Rows and columns of the array are counted from 0.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.language.text import dump
from labyrinth_core.world.grid import MAX_SIDE, MIN_SIDE, bit_set, cell_at
from labyrinth_core.world.labyrinth import Labyrinth, Structure
from labyrinth_core.world.tasks import default_start_and_goal

START, GOAL = 2, 3
"""The elements that mark cells; walls and openings are 0 and 1."""

SIZES = f"2h + 1 rows and 2w + 1 columns, h and w from {MIN_SIDE} to {MAX_SIDE:,}"
"""What shape a wall grid has, for messages."""

_ELEMENTS = {"|": 1, "-": 1, "+": 1, "S": START, "E": GOAL}


class GridError(ValueError):
    """An array that is no wall grid; the message begins with the place."""

    def __init__(self, row: int, column: int, message: str) -> None:
        super().__init__(f"row {row}, column {column}: {message}")
        self.row, self.column, self.message = row, column, message


def to_grid(labyrinth: Labyrinth) -> NDArray[np.uint8]:
    """Return the wall grid of a labyrinth, shape (2 height + 1, 2 width + 1), walls 1.

    Keys, doors and ice are left out.
    """
    drawing = dump(labyrinth).split("\n")[-(2 * labyrinth.structure.height + 3) : -2]
    return np.array([[_ELEMENTS.get(char, 0) for char in line[::2]] for line in drawing], np.uint8)


def from_grid(grid: NDArray[Any]) -> Labyrinth | Structure:
    """Return the labyrinth of a wall grid, a structure if it marks neither start nor goal.

    If it marks one of them, the other one is where the language has it: the start at the bottom
    left, the goal at the top right.

    Args:
        grid: Booleans or numbers, shape (2h + 1, 2w + 1).

    Raises:
        GridError: There is something in a place where it cannot be.
        ValueError: The array has no such shape, or the labyrinth breaks a rule.
    """
    check_shape(grid.shape)
    _refuse(~np.isin(grid, (0, 1, START, GOAL)), "expected 0, 1, 2 for the start or 3 for the goal")
    wall = grid == grid[0, 0]
    if grid[0, 0] > 1:
        raise GridError(0, 0, "start and goal are marked in cells, not in walls")
    inner = np.zeros_like(wall)
    inner[1:-1, 1:-1] = True
    _refuse(~inner & ~wall, "a gap in the outer wall")
    posts, cells = np.zeros_like(wall), np.zeros_like(wall)
    posts[::2, ::2] = cells[1::2, 1::2] = True
    _refuse(posts & ~wall, "no wall where four cells meet")
    _refuse(cells & wall, "a wall where a cell is")
    _refuse(~cells & (grid > 1), "start and goal are marked in cells, not between them")
    return labyrinth_of(
        structure_of(~wall[2:-1:2, 1::2], ~wall[1::2, 2:-1:2]),
        _marked(grid, START, "start"),
        _marked(grid, GOAL, "goal"),
    )


def check_shape(shape: tuple[int, ...]) -> None:
    """Raise a ValueError for a shape that no wall grid has."""
    fits = (side % 2 and MIN_SIDE <= side // 2 <= MAX_SIDE for side in shape)
    if len(shape) != 2 or not all(fits):
        sides = " x ".join(f"{side:,}" for side in shape)
        raise ValueError(f"{sides} elements, but a wall grid has {SIZES}")


def _refuse(wrong: NDArray[np.bool_], message: str) -> None:
    """Raise the error for the first place where an array is wrong."""
    if wrong.any():
        row, column = np.argwhere(wrong)[0].tolist()
        raise GridError(row, column, message)


def _marked(grid: NDArray[Any], mark: int, name: str) -> tuple[int, int] | None:
    """Return row, from the top, and column of the cell that has a mark."""
    places = [(int(row), int(column)) for row, column in np.argwhere(grid == mark)]
    if len(places) > 1:
        raise GridError(*places[1], f"another {name}: at most one is marked")
    return (places[0][0] // 2, places[0][1] // 2) if places else None


def structure_of(below: NDArray[np.bool_], beside: NDArray[np.bool_]) -> Structure:
    """Return the structure that has the given passages; rows are counted from the top.

    Args:
        below: Whether a passage leads from each cell to that below, shape (height - 1, width).
        beside: The same for the cell at the right, shape (height, width - 1).
    """
    height, width = len(beside), below.shape[1]
    up = np.zeros((height, width), np.uint8)
    right = up.copy()
    up[:-1], right[:, :-1] = below[::-1], beside[::-1]
    bits = (bit_set((each + ord("0")).tobytes().decode()) for each in (up, right))
    return Structure(height, width, *bits)


def labyrinth_of(
    structure: Structure, start: tuple[int, int] | None, goal: tuple[int, int] | None
) -> Labyrinth | Structure:
    """Return the labyrinth with a start and a goal, the structure itself if it has neither.

    Args:
        structure: The passages.
        start: Row, from the top, and column of the start, None for the bottom left cell.
        goal: The same for the goal, None for the top right cell.

    Raises:
        LabyrinthError: No route leads from start to goal.
    """
    if start is None and goal is None:
        return structure
    height, width = structure.height, structure.width
    ends = (
        cell if place is None else cell_at(height - 1 - place[0], place[1], width)
        for cell, place in zip(default_start_and_goal(height, width), (start, goal), strict=True)
    )
    return Labyrinth(structure, next(ends), next(ends))

"""Labyrinths as wall grids: arrays in which walls have elements of their own.

A labyrinth of h rows and w columns is an array of 2h + 1 rows and 2w + 1 columns, top row first,
counted from 0. Elements with odd row and odd column are cells. Elements with one of them odd are
passages or walls between two cells. All others are wall: the outer wall, and the points where four
cells meet. Walls are 1 and the rest is 0, or the other way round; the corner, always a wall, shows
which. A 2 marks the cell of the start, a 3 the cell of the goal.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.language.text import dump
from labyrinth_core.world import SIDES, Labyrinth, Structure, Structures

START, GOAL = 2, 3
"""The elements that mark start and goal; walls and openings are 0 and 1."""

SIZES = f"2h + 1 rows and 2w + 1 columns, h and w from {SIDES[0]} to {SIDES[-1]:,}"
"""The shapes that a wall grid can have, for messages."""

_ELEMENTS = {"|": 1, "-": 1, "+": 1, "S": START, "E": GOAL}


def to_grid(labyrinth: Labyrinth) -> NDArray[np.uint8]:
    """Return the wall grid of a labyrinth, shape (2 height + 1, 2 width + 1), walls 1.

    Keys, doors and ice are left out.
    """
    drawing = dump(labyrinth).split("\n")[-(2 * labyrinth.structure.height + 3) : -2]
    return np.array([[_ELEMENTS.get(char, 0) for char in line[::2]] for line in drawing], np.uint8)


def from_grid(grid: NDArray[Any]) -> Labyrinth | Structure:
    """Return the labyrinth of a wall grid, or its structure if neither start nor goal is marked.

    If only one of them is marked, the other is in its default place: the start at the bottom left,
    the goal at the top right.

    Args:
        grid: Booleans or numbers, shape (2h + 1, 2w + 1).

    Raises:
        ValueError: The array has another shape, an element is not allowed in its place (the message
            begins with the place), or the labyrinth breaks a rule.
    """
    fits = (side % 2 and side // 2 in SIDES for side in grid.shape)
    if grid.ndim != 2 or not all(fits):
        sides = " x ".join(f"{side:,}" for side in grid.shape)
        raise ValueError(f"{sides} elements, but a wall grid has {SIZES}")
    height, width = (side // 2 for side in grid.shape)
    wall = grid == grid[0, 0]
    inner, posts, cells = (np.zeros_like(wall) for _ in range(3))
    inner[1:-1, 1:-1] = posts[::2, ::2] = cells[1::2, 1::2] = True
    for wrong, message in (
        (~np.isin(grid, (0, 1, START, GOAL)), "expected 0, 1, 2 for the start or 3 for the goal"),
        (posts & wall & (grid > 1), "start and goal must be in cells, not in walls"),
        (~inner & ~wall, "a gap in the outer wall"),
        (posts & ~wall, "no wall where four cells meet"),
        (cells & wall, "a wall where a cell is"),
        (~cells & (grid > 1), "start and goal must be in cells, not between them"),
    ):
        if wrong.any():
            row, column = np.argwhere(wrong)[0].tolist()
            raise ValueError(f"row {row}, column {column}: {message}")
    # The lowest row first; for each cell, whether there is a passage above and to its right.
    is_open = ~wall[::-1]
    up, right = (each.reshape(1, -1) for each in (is_open[2::2, 1::2], is_open[1::2, 2::2]))
    structure = Structures(height, width, up, right)[0]
    ends = _marked(grid, START, "start"), _marked(grid, GOAL, "goal")
    if ends == (None, None):
        return structure
    start, goal = (
        default if marked is None else marked
        for marked, default in zip(ends, structure.default_ends, strict=True)
    )
    return Labyrinth(structure, start, goal)


def _marked(grid: NDArray[Any], mark: int, name: str) -> int | None:
    """Return the cell with a mark, or None if no cell has it."""
    marked = np.argwhere(grid == mark).tolist()
    if len(marked) > 1:
        row, column = marked[1]
        raise ValueError(f"row {row}, column {column}: a second {name}: mark at most one")
    height, width = (side // 2 for side in grid.shape)
    return (height - 1 - marked[0][0] // 2) * width + marked[0][1] // 2 if marked else None


def from_connections(connections: NDArray[Any]) -> Structure:
    """Return the structure of a maze from maze-dataset.

    Args:
        connections: Its `connection_list`, shape (2, rows, columns): whether a passage leads from
            each cell to the cell below, and to the cell on its right. The top row comes first.

    Raises:
        ValueError: The array has another shape or other elements, or a passage leaves the grid.
    """
    sides = connections.shape[1:]
    is_pair = connections.ndim == 3 and len(connections) == 2
    if not (is_pair and all(side in SIDES for side in sides)):
        raise ValueError(
            f"its connections have the shape {connections.shape}: expected (2, rows, columns), "
            f"both from {SIDES[0]} to {SIDES[-1]:,}"
        )
    if not np.isin(connections, (0, 1)).all():
        raise ValueError("its connections are not all 0 or 1")
    below, beside = connections != 0
    if below[-1].any() or beside[:, -1].any():
        raise ValueError("a passage leads out of the grid")
    # The lowest row first; a passage below a cell is one above the cell below.
    up, right = np.roll(below[::-1], -1, axis=0), beside[::-1]
    return Structures(sides[0], sides[1], up.reshape(1, -1), right.reshape(1, -1))[0]

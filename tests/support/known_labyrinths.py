"""Labyrinths that several tests look at: texts, and a small one as a wall grid with its file."""

from __future__ import annotations

import io

import numpy as np

from labyrinth_core.world import Labyrinth, Structure

OPEN = """
labyrinth:
---------
|     E |
|   +   |
| S     |
---------
end
"""
SMALL_KEY_AND_DOOR = """
key_and_lock: True
labyrinth:
-------------
| K | D   E |
|   +   + - |
| S         |
-------------
end
"""
KEY_AND_DOOR = """
key_and_lock: True

labyrinth:
-------------
|   | D   E |
|   +   + - |
|           |
|   + - +   |
| S     | K |
-------------
end
"""


GRID = np.array(
    [
        [1, 1, 1, 1, 1, 1, 1],
        [1, 0, 0, 0, 1, 3, 1],
        [1, 0, 1, 0, 1, 0, 1],
        [1, 2, 1, 0, 0, 0, 1],
        [1, 1, 1, 1, 1, 1, 1],
    ],
    np.uint8,
)
BARE = np.where(GRID > 1, 0, GRID)
LABYRINTH = Labyrinth(Structure.from_passages(2, 3, [(0, 3), (3, 4), (1, 4), (1, 2), (2, 5)]), 0, 5)


def changed(row, column, element, grid=GRID):
    grid = grid.copy()
    grid[row, column] = element
    return grid


def npy(array):
    file = io.BytesIO()
    np.save(file, array)
    return file.getvalue()

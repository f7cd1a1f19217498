"""A small labyrinth as a wall grid, and the files that it may come in."""

from __future__ import annotations

import io
import zipfile

import numpy as np
from PIL import Image

from labyrinth_core.world.labyrinth import Labyrinth, Structure

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
LABYRINTH = Labyrinth(Structure.from_passages(2, 3, [(0, 3), (3, 4), (1, 4), (1, 2), (2, 5)]), 0, 5)

COLOURS = np.array([[255, 255, 255], [0, 0, 0], [0, 255, 0], [255, 0, 0], [0, 0, 255]], np.uint8)
"""The colour of each element where walls are 1, and of a route."""


def inverted(grid):
    return np.where(grid < 2, 1 - grid.astype(int), grid)


def png_of(pixels, scale=1):
    """Return the PNG file of an array, or of an image of Pillow, each element some pixels."""
    if isinstance(pixels, np.ndarray):
        pixels = Image.fromarray(pixels)
    file = io.BytesIO()
    size = (scale * pixels.width, scale * pixels.height)
    pixels.resize(size, Image.Resampling.NEAREST).save(file, "PNG")
    return file.getvalue()


def changed(row, column, element, grid=GRID):
    grid = grid.copy()
    grid[row, column] = element
    return grid


def npy(array):
    file = io.BytesIO()
    np.save(file, array)
    return file.getvalue()


def zipped(members):
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as archive:
        for name, data in members.items():
            archive.writestr(name, data)
    return file.getvalue()

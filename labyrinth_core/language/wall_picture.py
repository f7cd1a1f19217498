"""Pictures of wall grids, one pixel an element or a square of pixels, as arrays and labyrinths.

Walls are black and the rest is white, or the other way round. Green is the start and red the goal,
and blue, a route that somebody drew, is open: these are the colours of maze-dataset
(`PixelColors`, https://github.com/understanding-search/maze-dataset).
"""

from __future__ import annotations

import io
import struct
from itertools import chain
from math import gcd
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.language.wall_grid import GOAL, START, GridError, check_shape, from_grid
from labyrinth_core.world.labyrinth import Labyrinth, Structure

MAX_PIXELS = 1 << 25
"""The largest number of pixels, which bounds what the picture of a stranger can cost."""

_ROUTE = 4
_COLOURS = {0x000000: 0, 0xFFFFFF: 1, 0x00FF00: START, 0xFF0000: GOAL, 0x0000FF: _ROUTE}
"""The element of a wall grid that each colour stands for."""


def from_picture(png: bytes) -> Labyrinth | Structure:
    """Return the labyrinth of a PNG file, a structure if it shows neither start nor goal.

    Raises:
        GridError: There is something in a place where it cannot be; the place is that of a pixel.
        ValueError: It is no such picture, or the labyrinth breaks a rule.
    """
    pixels = _decoded(png)
    scale = _scale(pixels)
    squares = pixels[::scale, ::scale]
    check_shape(squares.shape[:2])  # Before more memory is taken.
    colours = squares.astype(np.int64) @ (1 << 16, 1 << 8, 1)
    grid = np.full(colours.shape, -1)
    for colour, element in _COLOURS.items():
        grid[colours == colour] = element
    unknown = np.argwhere(grid < 0).tolist()
    if unknown:
        row, column = unknown[0]
        expected = "expected black, white, green (start), red (goal) or blue (a route)"
        message = f"{expected}, found #{colours[row, column]:06x}"
        raise GridError(scale * row, scale * column, message)
    grid[grid == _ROUTE] = int(grid[0, 0] == 0)
    try:
        return from_grid(grid)
    except GridError as error:
        place = scale * error.row, scale * error.column
        raise GridError(*place, error.message) from error


def _decoded(png: bytes) -> NDArray[np.uint8]:
    """Return the pixels of a PNG file, shape (height, width, 3)."""
    if not (png.startswith(b"\x89PNG\r\n\x1a\n") and len(png) >= 24):
        raise ValueError("no PNG file")
    width, height = struct.unpack_from(">II", png, 16)  # Before anything is decompressed.
    if width * height > MAX_PIXELS:
        raise ValueError(f"{width:,} x {height:,} pixels are more than {MAX_PIXELS:,}")
    try:
        from PIL import Image
    except ImportError as error:
        raise ValueError("reading pictures needs Pillow: pip install pillow") from error
    try:
        with Image.open(io.BytesIO(png), formats=["PNG"]) as image:
            return np.asarray(image.convert("RGB"))
    except (OSError, SyntaxError, ValueError) as error:
        raise ValueError("a damaged PNG file") from error


def _scale(pixels: NDArray[Any]) -> int:
    """Return the side of the largest squares of one colour that the whole picture consists of."""
    changes = (
        np.flatnonzero((np.diff(pixels, axis=axis) != 0).any(axis=(1 - axis, 2))) + 1
        for axis in (0, 1)
    )
    return gcd(*pixels.shape[:2], *map(int, chain.from_iterable(changes)))

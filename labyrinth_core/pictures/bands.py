"""Turn the bands of a picture into its pixels, at any size.

A picture at `PICTURE_SIZE` consists of bands of rows times bands of columns: margins, walls, and
the spaces between two walls. If P holds the colours of the bands, the picture at another size is
A P B, where A and B say how much of each band the rows and columns of pixels cover. A square inside
a cell, such as the agent, adds the product of a column vector and a row vector. All numbers are
integers that floats hold exactly, so the order of additions does not matter.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.pictures.png import PICTURE_SIZE
from labyrinth_core.pictures.renderer import AGENT_INSET, grid_of
from labyrinth_core.pictures.resize import weights

Sums = NDArray[np.floating[Any]]
"""Integers, held in single-precision floats if they are below 2 ** 24, else in double precision."""

INSETS = (1, AGENT_INSET, 3, 4)
"""The distances of the squares inside cells from the walls, in twelfths of a cell."""


@dataclass(frozen=True, eq=False)
class Axis:
    """The weights of bands, and of squares in cells, in the lines of pixels along an axis.

    Bands and lines are numbered from the top left, rows of cells from the bottom.
    """

    bands: Sums
    """The weight of each band in each line, shape (lines, 2 * cells + 3)."""
    squares: dict[int, Sums]
    """Inset -> the weight of the square in each cell in each line, shape (cells, lines)."""
    begins: NDArray[np.intp]
    """The first line of the window around an agent in each cell, shape (cells,)."""
    in_windows: dict[int, Sums]
    """Inset -> the weight of the square in each line of the window, shape (cells, reach)."""


@dataclass(frozen=True, eq=False)
class Bands:
    """How the bands of pictures of labyrinths of one size become pixels."""

    rows: Axis
    """The distinct rows of pixels in `bands` and `squares`; many rows of a picture are equal."""
    columns: Axis
    row: NDArray[np.intp]
    """The index of the distinct row that each row of pixels equals, shape (image_size,)."""
    row_in_windows: NDArray[np.intp]
    """The same for the rows of the windows, shape (height, reach)."""
    unit: int
    """The sum of the weights of a pixel."""
    reach: int
    """The side of a window in pixels, whatever the thickness of walls."""

    def rounded(self, sums: Sums) -> NDArray[np.uint8]:
        """Return the colours of sums, to which half a unit was added for rounding."""
        # Truncating is exact: a quotient between two integers is more than 2 ** -16 below the upper
        # one, so it cannot round up to it, as single-precision floats below 256 are that close.
        colours = np.empty(sums.shape, np.uint8)
        return np.divide(sums, self.unit, out=colours, casting="unsafe")


# Without the cache, drawing the 25 states of a labyrinth takes four times as long.
@lru_cache(maxsize=16)
def bands_of(
    height: int,
    width: int,
    wall_pixels: int | None,
    image_size: int,
    resize: str = "area",
    insets: tuple[int, ...] = INSETS,
) -> Bands:
    """Return how the bands of pictures of labyrinths of one size become pixels.

    Args:
        height: Rows of cells.
        width: Columns of cells.
        wall_pixels: The thickness of walls, as in `Style`.
        image_size: Pixels on each side of a picture.
        resize: One of `resize.RESIZES`.
        insets: Which of `INSETS` cells may show besides the agent; fewer give fewer distinct rows.

    Raises:
        ValueError: The labyrinth is too large for every wall to have a pixel.
    """
    grid = grid_of(height, width, wall_pixels)
    shares = weights(image_size, resize)
    unit = int(shares[0].sum()) ** 2
    dtype = np.dtype(np.float32 if 256 * unit < 2**24 else np.float64)
    up_to = np.zeros((image_size, PICTURE_SIZE + 1), dtype)
    np.cumsum(shares, axis=1, out=up_to[:, 1:])
    reach = _reach(max(height, width), image_size)
    rows = _axis(grid.rows[::-1], grid.thickness, up_to, reach)
    parts = np.concatenate([rows.bands.T, *[rows.squares[inset] for inset in insets]])
    _, some, row = np.unique(parts, axis=1, return_index=True, return_inverse=True)
    return Bands(
        rows=Axis(
            rows.bands[some],
            {inset: rows.squares[inset][:, some] for inset in insets},
            rows.begins,
            rows.in_windows,
        ),
        columns=_axis(grid.columns, grid.thickness, up_to, reach),
        row=row,
        row_in_windows=row[rows.begins[:, None] + np.arange(reach)],
        unit=unit,
        reach=reach,
    )


def _axis(lines: tuple[int, ...], thickness: int, up_to: Sums, reach: int) -> Axis:
    """Return the weights along an axis.

    Args:
        lines: The first pixel of each wall, beginning with the wall before cell 0.
        thickness: The thickness of walls.
        up_to: The cumulative weight of all pixels before each, (image_size, PICTURE_SIZE + 1).
        reach: The length of windows.
    """
    walls = np.array(lines)
    edges = np.sort(np.concatenate([[0, PICTURE_SIZE], walls, walls + thickness]))
    low, high = np.minimum(walls[:-1], walls[1:]) + thickness, np.maximum(walls[:-1], walls[1:])
    into = {inset: (high - low) * inset // 12 for inset in INSETS}
    squares: dict[int, Sums] = {
        inset: (up_to[:, high - each] - up_to[:, low + each]).T for inset, each in into.items()
    }
    first = squares[AGENT_INSET].astype(np.bool_).argmax(axis=1)
    begins = np.minimum(first, len(up_to) - reach)
    windows = begins[:, None] + np.arange(reach)
    in_windows: dict[int, Sums] = {
        inset: np.take_along_axis(each, windows, axis=1) for inset, each in squares.items()
    }
    return Axis(up_to[:, edges[1:]] - up_to[:, edges[:-1]], squares, begins, in_windows)


def _reach(most: int, image_size: int) -> int:
    """Return the largest number of pixels in a line that the square of an agent can touch."""
    wide = -(-PICTURE_SIZE // most) - 1  # Walls are at least a pixel thick.
    # In a narrower cell the square may be a pixel wider, since insets are rounded down.
    square = wide - 2 * (wide * AGENT_INSET // 12) + 2
    return min(image_size, square * image_size // PICTURE_SIZE + 2)

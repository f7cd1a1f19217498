"""Draw many scenes, which are pictures without agents, at once; then paste each agent as a patch.

A picture at `PICTURE_SIZE` consists of bands of rows times bands of columns: margins, walls, and
the spaces between two walls. If P holds the colours of the bands, the picture at another size is
A P B, where A and B say how much of each band the rows and columns of pixels cover. A square inside
a cell, such as the agent, adds the product of a column vector and a row vector. All numbers are
integers that floats hold exactly, so the order of additions does not matter. A patch is the small
window of a picture in which it differs from its scene.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.pictures.png import PICTURE_SIZE
from labyrinth_core.pictures.renderer import (
    AGENT_INSET,
    AGENT_WITH_KEY,
    CODE_OF,
    CODES,
    DOOR,
    FLOOR,
    GOAL,
    HIDDEN,
    KEY,
    OPEN_DOOR,
    START,
    grid_of,
    squares,
)
from labyrinth_core.pictures.resize import weights
from labyrinth_core.pictures.style import Colour, Style
from labyrinth_core.pictures.vector import hide
from labyrinth_core.world import Task

Sums = NDArray[np.floating[Any]]
"""Integers, held in single-precision floats if they are below 2 ** 24, else in double precision."""

INSETS = (1, AGENT_INSET, 3, 4)
"""The distances of the squares inside cells from the walls, in twelfths of a cell."""

MOST_PRODUCTS = 2**18
"""The most products of numbers for two matrices that OpenBLAS multiplies in one thread."""

Pictures = NDArray[np.uint8]
"""Shape (N, image_size, image_size, 3)."""
Numbers = NDArray[np.intp]
Mask = NDArray[np.bool_]
Corners = tuple[Numbers, Numbers]
"""The first row and the first column of pixels of each window."""

_WALL_CODE = CODES
_CODE_OF_ENTRY = {
    task: np.array([FLOOR, _WALL_CODE, *map(CODE_OF.__getitem__, task.rules.grounds)], np.uint8)
    for task in Task
}
"""Task -> the code for each entry of a wall grid, see `vector`."""

SUMS_BYTES = 2**20
"""The memory for the sums of scenes drawn together, chosen to fit the processor's cache."""


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

    @cached_property
    def touched(self) -> dict[int, tuple[Numbers, Sums]]:
        """Inset -> the lines that the square in each cell touches, and its weight in each of them.

        Both have the shape (cells, most), where most is the number of lines that some square
        touches.
        """
        found = {}
        for inset, shares in self.squares.items():
            touched = shares.astype(np.bool_)
            most = touched.sum(axis=1).max()
            lines = np.argsort(~touched, axis=1, kind="stable")[:, :most]
            found[inset] = lines, np.take_along_axis(shares, lines, axis=1)
        return found


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
    wide = -(-PICTURE_SIZE // max(height, width)) - 1  # Walls are at least a pixel thick.
    # In a narrower cell the square may be a pixel wider, since insets are rounded down.
    square = wide - 2 * (wide * AGENT_INSET // 12) + 2
    reach = min(image_size, square * image_size // PICTURE_SIZE + 2)
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


class Scenes(NamedTuple):
    """N scenes of labyrinths of one size and task."""

    height: int
    width: int
    task: Task
    vectors: NDArray[np.int32]
    """The `initial_vector` of each scene's labyrinth, shape (N, length)."""
    key_gone: Mask
    door_open: Mask
    visible: Mask | None = None
    """Which cells are visible, shape (N, height, width); None without partial observability."""

    def take(self, part: slice) -> Scenes:
        """Return some of the scenes."""
        return self._replace(
            vectors=self.vectors[part],
            key_gone=self.key_gone[part],
            door_open=self.door_open[part],
            visible=None if self.visible is None else self.visible[part],
        )


def backdrops_of(
    scenes: Scenes, image_size: int, style: Style, resize: str = "area"
) -> Iterator[tuple[int, Backdrops]]:
    """Yield the scenes in batches that fit the cache: the index of the first, and the backdrops."""
    phases = scenes.task.rules.phases
    bands = _bands_of(scenes.height, scenes.width, style.wall_pixels, image_size, resize, phases)
    together = max(1, SUMS_BYTES // (3 * bands.rows.bands[:, 0].nbytes * image_size))
    for first in range(0, len(scenes.vectors), together):
        yield first, Backdrops(scenes.take(slice(first, first + together)), bands, style)


def memory_of_scene(
    height: int, width: int, wall_pixels: int | None, image_size: int, resize: str, phases: int
) -> int:
    """Return the bytes that a scene takes: its sums, and a byte for each of their colours."""
    lines = _bands_of(height, width, wall_pixels, image_size, resize, phases).rows.bands[:, 0]
    return 3 * image_size * (lines.nbytes + lines.size)


def _bands_of(
    height: int, width: int, wall_pixels: int | None, image_size: int, resize: str, phases: int
) -> Bands:
    insets = INSETS if phases > 1 else ()
    return bands_of(height, width, wall_pixels, image_size, resize, insets)


class Backdrops:
    """Scenes of labyrinths of one size, task and style, drawn and ready for agents."""

    def __init__(self, scenes: Scenes, bands: Bands, style: Style) -> None:
        self._count, self._bands = len(scenes.vectors), bands
        self._width = scenes.width
        self._codes, shown = _codes(scenes)
        self._palette = _palette(style, bands.rows.bands.dtype)
        self._sums = self._drawn(shown)
        if scenes.task.rules.phases > 1:
            for code in (KEY, OPEN_DOOR):
                self._add_squares(code, squares(style, code))
        self._colours = bands.rounded(self._sums)

    @classmethod
    def joined(cls, parts: Iterable[tuple[int, Backdrops]], count: int) -> Backdrops:
        """Return the scenes of all parts as one, from which states are drawn in one go.

        Args:
            parts: The index of each part's first scene, and the part; at least one.
            count: The number of scenes of all parts.
        """
        whole = cls.__new__(cls)
        for first, part in parts:
            if not first:
                whole._count, whole._bands = count, part._bands
                whole._width, whole._palette = part._width, part._palette
                whole._codes, whole._sums, whole._colours = (
                    np.empty((count, *each.shape[1:]), each.dtype)
                    for each in (part._codes, part._sums, part._colours)
                )
            own = slice(first, first + len(part))
            whole._codes[own], whole._sums[own] = part._codes, part._sums
            whole._colours[own] = part._colours
        return whole

    def _drawn(self, shown: NDArray[np.uint8]) -> Sums:
        """Return the sums of scenes without squares, given the codes of their bands.

        Scenes are multiplied together, one channel at a time, up to `MOST_PRODUCTS`: BLAS divides
        more among threads, which took twice the processor time and hardly less of the clock's.
        """
        rows, columns = self._bands.rows.bands, self._bands.columns.bands
        count, height, width = shown.shape
        sums = np.empty((count, len(rows), len(columns), 3), rows.dtype)
        together = max(1, MOST_PRODUCTS // (len(rows) * max(height, len(columns)) * width))
        for first in range(0, count, together):
            part = sums[first : first + together]
            abreast = shown[first : first + together].transpose(1, 0, 2)
            for channel in range(3):
                planes = self._palette.ground[:, channel][abreast].reshape(height, -1)
                lines = (rows @ planes).reshape(-1, len(part), width).transpose(1, 0, 2)
                drawn = lines.reshape(-1, width) @ columns.T
                part[..., channel] = drawn.reshape(part.shape[:3])
        sums += self._bands.unit // 2
        return sums

    def __len__(self) -> int:
        """Return the number of scenes."""
        return self._count

    def _add_squares(self, code: int, nested: Sequence[tuple[int, Colour]]) -> None:
        """Add the squares inside the cells that show a code, at most one such cell per scene."""
        scenes, cells = np.nonzero(self._codes == code)
        row, column = np.divmod(cells, self._width)
        for (_, outer), (inset, inner) in pairwise(nested):
            if inset:
                lines, down = (each[row] for each in self._bands.rows.touched[inset])
                columns, across = (each[column] for each in self._bands.columns.touched[inset])
                change = np.subtract(inner, outer, dtype=down.dtype)
                where = scenes[:, None, None], lines[:, :, None], columns[:, None]
                self._sums[where] += (down[:, :, None] * across[:, None])[..., None] * change

    def bare(self) -> Pictures:
        """Return the picture of each scene, shape (N, image_size, image_size, 3)."""
        return self._colours.take(self._bands.row, axis=1)

    def draw(self, pictures: Pictures, scenes: Numbers, agents: Numbers, with_key: Mask) -> None:
        """Fill pictures with a scene and an agent each; the arguments are those of `patches`."""
        lines, *row = self._colours.shape[1:]
        rows = scenes[:, None] * lines + self._bands.row
        # Every index is within bounds; clipping only spares a copy.
        self._colours.reshape(-1, *row).take(rows, axis=0, out=pictures, mode="clip")
        # An agent that returns to a cell looks the same, so draw each patch once.
        kinds = 2 * (scenes * self._codes.shape[1] + agents) + with_key
        _, some, which = np.unique(kinds, return_index=True, return_inverse=True)
        patches = self.patches(scenes[some], agents[some], with_key[some])
        paste(pictures, np.arange(len(agents)), self.corners(agents), patches[which])

    def corners(self, agents: Numbers) -> Corners:
        """Return the first rows and the first columns of the windows around agents."""
        row, column = np.divmod(agents, self._width)
        return self._bands.rows.begins[row], self._bands.columns.begins[column]

    def patches(self, scenes: Numbers, agents: Numbers, with_key: Mask) -> Pictures:
        """Return the windows around agents in some scenes, shape (N, reach, reach, 3).

        Args:
            scenes: The index of each scene.
            agents: The agents' cells.
            with_key: Whether the agents show a key.
        """
        bands = self._bands
        row, column = np.divmod(agents, self._width)
        lines, lefts = bands.row_in_windows[row], bands.columns.begins[column]
        cut_out = _runs(self._sums, bands.reach)[scenes[:, None], lines, lefts[:, None]]
        sums = cut_out.view(self._sums.dtype).reshape(*lines.shape, bands.reach, 3)
        changes = self._palette.agent[self._codes[scenes, agents]]
        self._add_to_windows(sums, row, column, AGENT_INSET, changes)
        if with_key.any():
            changes = self._palette.key * with_key[:, None]
            self._add_to_windows(sums, row, column, self._palette.key_inset, changes)
        return bands.rounded(sums)

    def _add_to_windows(
        self, sums: Sums, row: Numbers, column: Numbers, inset: int, changes: Sums
    ) -> None:
        down = self._bands.rows.in_windows[inset][row]
        across = self._bands.columns.in_windows[inset][column]
        sums += down[:, :, None, None] * (across[:, :, None] * changes[:, None])[:, None]


class _Palette(NamedTuple):
    """The colours of a style, and the differences that added squares make."""

    ground: Sums
    """The colour of each code without squares inside, and of walls last, shape (CODES + 1, 3)."""
    agent: Sums
    """The agent's colour minus the colour of each code that it covers, shape (CODES, 3)."""
    key: Sums
    """The key's colour minus the agent's, shape (3,)."""
    key_inset: int


# Without the cache a single picture of 64 x 64 takes 1.3 times as long.
@lru_cache(maxsize=64)
def _palette(style: Style, dtype: np.dtype[Any]) -> _Palette:
    nested = [squares(style, code) for code in range(CODES)]
    *_, (_, agent), (key_inset, key) = squares(style, FLOOR + AGENT_WITH_KEY)
    covered = np.array([_innermost(each, AGENT_INSET) for each in nested], dtype)
    return _Palette(
        ground=np.array([*[_innermost(each, 0) for each in nested], style.wall], dtype),
        agent=np.array(agent, dtype) - covered,
        key=np.subtract(key, agent, dtype=dtype),
        key_inset=key_inset,
    )


def _innermost(nested: Sequence[tuple[int, Colour]], inset: int) -> Colour:
    """Return the colour of the innermost of nested squares whose inset is at most `inset`."""
    return [colour for twelfths, colour in nested if twelfths <= inset][-1]


def _codes(scenes: Scenes) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Return the codes of the cells of scenes, and the codes of their bands, from the top left.

    Returns:
        Shapes (N, cells) and (N, 2 height + 3, 2 width + 3).
    """
    height, width, first = scenes.height, scenes.width, scenes.task.rules.positions
    tiles = scenes.vectors[:, :first]
    grids = scenes.vectors[:, first:].reshape(-1, 2 * height - 1, 2 * width - 1)
    if scenes.visible is not None:
        grids = grids.copy()
        hide(grids, scenes.visible)
    shown = _CODE_OF_ENTRY[scenes.task][grids]
    cells = shown[:, ::2, ::2]
    cells[cells == _WALL_CODE] = HIDDEN  # A cell is a wall only where it is hidden.
    count = len(tiles)
    every, entries = np.arange(count), shown.reshape(count, -1)
    entries[every, tiles[:, 1]], entries[every, tiles[:, 2]] = START, GOAL
    if scenes.task.rules.phases > 1:
        entries[every, tiles[:, 3]] = np.where(scenes.key_gone, FLOOR, KEY)
        entries[every, tiles[:, 4]] = np.where(scenes.door_open, OPEN_DOOR, DOOR)
    bands = np.full((count, 2 * height + 3, 2 * width + 3), FLOOR, np.uint8)
    bands[:, 1:-1, 1:-1] = _WALL_CODE
    bands[:, 2:-2, 2:-2] = shown[:, ::-1]
    return cells.reshape(count, -1), bands


# Windows of pictures. Each row of a window is one item of a view, so that NumPy copies it at once.


def paste(pictures: Pictures, indices: Numbers, corners: Corners, patches: Pictures) -> None:
    """Put a patch into each of some pictures.

    Args:
        pictures: Shape (N, image_size, image_size, 3), C-contiguous.
        indices: The index of the picture of each patch, shape (M,).
        corners: The first row and the first column of each patch, shape (M,) each.
        patches: Shape (M, reach, reach, 3).
    """
    reach = patches.shape[1]
    rows = _runs(pictures, reach)
    where = _where(indices, corners, reach)
    rows[where] = patches.reshape(len(patches), reach, 3 * reach).view(rows.dtype)[..., 0]


def cut(pictures: Pictures, indices: Numbers, corners: Corners, reach: int) -> Pictures:
    """Return the patches of pictures, `reach` pixels high and wide, where `paste` puts them."""
    rows = _runs(pictures, reach)[_where(indices, corners, reach)]
    return rows.view(np.uint8).reshape(len(indices), reach, reach, 3)


def _where(indices: Numbers, corners: Corners, reach: int) -> tuple[Numbers, Numbers, Numbers]:
    """Return the indices of the runs of patches, see `_runs`."""
    tops, lefts = corners
    return indices[:, None], tops[:, None] + np.arange(reach), lefts[:, None]


def _runs(pixels: NDArray[Any], length: int) -> NDArray[np.void]:
    """Return a view whose items are the runs of pixels along a row, one beginning at each pixel.

    Args:
        pixels: Shape (N, rows, columns, 3), C-contiguous.
        length: The length of a run; the view has the shape (N, rows, columns - length + 1).
    """
    count, rows, columns, _ = pixels.shape
    item = np.dtype((np.void, length * pixels.strides[2]))
    shape = (count, rows, columns - length + 1)
    view: NDArray[np.void] = np.ndarray(shape, item, pixels.data, strides=pixels.strides[:3])
    return view

"""The picture of a state: flat colours on a grid with black walls.

Everything is made of upright rectangles, so a picture is a few distinct rows of pixels, each
repeated; `png` lives on that. Cells are square, whatever the shape of the labyrinth.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.dynamics import State
from labyrinth_core.labyrinth import Labyrinth, Task
from labyrinth_core.png import Band, KeptStrip, Strip, encode
from labyrinth_core.visibility import visible_from

PICTURE_SIZE = 600
"""Pixels on each side of the picture in the datasets."""
MAX_PICTURED_SIDE = (PICTURE_SIZE - 1) // 2
"""Most rows and columns of a labyrinth of which each cell and wall still has a pixel."""

Colour = tuple[int, int, int]


@dataclass(frozen=True, eq=False)
class Style:
    """The colours, red, green and blue from 0 to 255, and how thick walls are.

    The defaults give start, goal and agent the roles red, blue and green have in the original,
    in the shades of Okabe and Ito that the colour-blind can tell apart
    (https://jfly.uni-koeln.de/color/).
    """

    floor: Colour = (255, 255, 255)
    wall: Colour = (0, 0, 0)
    hidden: Colour = (0, 0, 0)
    start: Colour = (213, 94, 0)
    goal: Colour = (0, 114, 178)
    agent: Colour = (0, 158, 115)
    key: Colour = (240, 228, 66)
    door: Colour = (128, 72, 32)
    ice: Colour = (170, 217, 242)
    wall_pixels: int | None = None
    """Of `PICTURE_SIZE`; None: a twelfth of a cell, or two pixels if that is more."""


DEFAULT_STYLE = Style()

# What a cell shows, as a number: one of these, plus one for the agent if it is there.
_FLOOR, _START, _GOAL, _KEY, _DOOR, _OPEN_DOOR, _ICE, _HIDDEN = range(8)
_AGENT, _AGENT_WITH_KEY = 8, 16


def render(
    labyrinth: Labyrinth,
    state: State,
    image_size: int = PICTURE_SIZE,
    style: Style = DEFAULT_STYLE,
) -> NDArray[np.uint8]:
    """Return the picture of a state, shape (image_size, image_size, 3), rows from the top.

    Any size but `PICTURE_SIZE` is the picture of that size, area-averaged.

    Raises:
        ValueError: The labyrinth is too large for every wall to have a pixel.
    """
    return Painter(labyrinth, style).array(state, image_size)


def render_png(labyrinth: Labyrinth, state: State, style: Style = DEFAULT_STYLE) -> bytes:
    """Return the picture of a state as a PNG file of `PICTURE_SIZE`; raises as `render`."""
    return Painter(labyrinth, style).png(state)


class Painter:
    """Draws the states of one labyrinth, doing but once what they have in common."""

    def __init__(self, labyrinth: Labyrinth, style: Style = DEFAULT_STYLE) -> None:
        structure = labyrinth.structure
        self._labyrinth = labyrinth
        self._style = style
        self._grid = _grid(structure.height, structure.width, style.wall_pixels)
        width = structure.width
        everything = (1 << width) - 1
        self._rows = [
            _Row(
                codes=[_FLOOR] * width,
                right=structure.right >> row * width & everything,
                up=structure.up >> row * width & everything,
            )
            for row in range(structure.height)
        ]
        tiles = [(labyrinth.start, _START), (labyrinth.goal, _GOAL)]
        tiles += [(cell, _ICE) for cell in labyrinth.ice]
        if labyrinth.key is not None and labyrinth.door is not None:
            tiles += [(labyrinth.key, _KEY), (labyrinth.door, _DOOR)]
        for cell, code in tiles:
            row, column = divmod(cell, width)
            self._rows[row].codes[column] = code
        self._strips = self._draw([everything] * structure.height)

    def png(self, state: State) -> bytes:
        """Return the picture of a state as a PNG file of `PICTURE_SIZE`."""
        return encode(self.strips(state), PICTURE_SIZE)

    def array(self, state: State, image_size: int = PICTURE_SIZE) -> NDArray[np.uint8]:
        """Return the picture of a state, shape (image_size, image_size, 3)."""
        bands = [band for strip in self.strips(state) for band in strip]
        counts = np.array([count for _, count in bands])
        if image_size == PICTURE_SIZE:
            rows = np.frombuffer(b"".join([row for row, _ in bands]), np.uint8)
            return rows.reshape(len(bands), PICTURE_SIZE, 3).repeat(counts, axis=0)
        narrowed = np.stack([_narrow(row, image_size) for row, _ in bands])
        return _shorten(narrowed, counts, image_size)

    def strips(self, state: State) -> list[Strip]:
        """Return the picture of a state as strips, from top to bottom, for `png.encode`."""
        labyrinth = self._labyrinth
        agent = _AGENT_WITH_KEY if state.has_key and not state.door_open else _AGENT
        changed: dict[int, list[int]] = {}

        def change(cell: int, code: int) -> None:
            row, column = divmod(cell, labyrinth.structure.width)
            codes = changed.setdefault(row, list(self._rows[row].codes))
            codes[column] = code

        if state.has_key and labyrinth.key is not None:
            change(labyrinth.key, _FLOOR)
        if state.door_open and labyrinth.door is not None:
            change(labyrinth.door, _OPEN_DOOR)
        row, column = divmod(state.agent, labyrinth.structure.width)
        under = changed.get(row, self._rows[row].codes)[column]
        change(state.agent, under + agent)
        if labyrinth.task is Task.PARTIAL_OBSERVABILITY:
            return self._draw_seen(state, changed)
        strips = self._strips.copy()
        for row, codes in changed.items():
            strips[self._grid.place_of_row(row)] = self._tiles(row, codes)
        return strips

    def _draw_seen(self, state: State, changed: dict[int, list[int]]) -> list[Strip]:
        structure = self._labyrinth.structure
        seen = visible_from(structure, state.agent)
        always = {self._labyrinth.start, self._labyrinth.goal}
        seen_bits = []
        codes_of_rows = {}
        for row in range(structure.height):
            cells = range(row * structure.width, (row + 1) * structure.width)
            codes = changed.get(row, self._rows[row].codes)
            codes_of_rows[row] = [
                code if cell in seen or cell in always else _HIDDEN
                for cell, code in zip(cells, codes, strict=True)
            ]
            seen_bits.append(sum((cell in seen) << place for place, cell in enumerate(cells)))
        return self._draw(seen_bits, codes_of_rows)

    def _draw(
        self, seen: list[int], codes_of_rows: dict[int, list[int]] | None = None
    ) -> list[Strip]:
        """Return all strips; `seen` holds a bit set of columns for each row of cells."""
        grid, style = self._grid, self._style
        last = len(self._rows) - 1
        strips = [grid.margin_strip(grid.top, style.floor)] if grid.top else []
        strips.append(_line(grid, style, 0))
        for row in range(last, -1, -1):
            codes = self._rows[row].codes if codes_of_rows is None else codes_of_rows[row]
            strips.append(self._tiles(row, codes, seen[row]))
            below = self._rows[row - 1].up & (seen[row] | seen[row - 1]) if row else 0
            strips.append(_line(grid, style, below))
        if grid.bottom:
            strips.append(grid.margin_strip(grid.bottom, style.floor))
        return strips

    def _tiles(self, row: int, codes: list[int], seen: int = -1) -> Strip:
        passages = self._rows[row].right & (seen | seen >> 1)
        return _tiles(self._grid, self._style, self._grid.tall(row), tuple(codes), passages)


class _Row(NamedTuple):
    """A row of cells: what they show, and their open passages as bit sets over columns."""

    codes: list[int]
    right: int
    up: int


@dataclass(frozen=True, eq=False)
class _Grid:
    """Where the walls are, in pixels from the top left."""

    columns: tuple[int, ...]
    """First pixel of each vertical wall, width + 1 of them."""
    rows: tuple[int, ...]
    """First pixel of each horizontal wall, height + 1 of them, from the top."""
    thickness: int

    @property
    def top(self) -> int:
        return self.rows[0]

    @property
    def bottom(self) -> int:
        return PICTURE_SIZE - self.rows[-1] - self.thickness

    def tall(self, row: int) -> int:
        """Return the pixels between the walls above and below a row of cells."""
        above = len(self.rows) - 2 - row
        return self.rows[above + 1] - self.rows[above] - self.thickness

    def place_of_row(self, row: int) -> int:
        """Return which strip of the picture shows a row of cells."""
        return 2 * (len(self.rows) - 2 - row) + 1 + (self.top > 0)

    def margin_strip(self, height: int, colour: Colour) -> Strip:
        return ((bytes(colour) * PICTURE_SIZE, height),)

    def pixels(self, wall: bytes, between: list[bytes], floor: bytes, passages: int) -> bytes:
        """Return a row of pixels: margin, then walls and what is `between` them, margin."""
        left, right = self.columns[0], PICTURE_SIZE - self.columns[-1] - self.thickness
        parts = [floor * left, wall * self.thickness]
        for column, tile in enumerate(between):
            parts.append(tile)
            parts.append((floor if passages >> column & 1 else wall) * self.thickness)
        parts.append(floor * right)
        return b"".join(parts)

    def wide(self, column: int) -> int:
        """Return the pixels between the walls left and right of a column."""
        return self.columns[column + 1] - self.columns[column] - self.thickness


@lru_cache(maxsize=64)
def _grid(height: int, width: int, wall_pixels: int | None = None) -> _Grid:
    most = max(height, width)
    if most > MAX_PICTURED_SIDE:
        raise ValueError(
            f"a {height}x{width} labyrinth does not fit a picture of {PICTURE_SIZE} pixels: "
            f"{MAX_PICTURED_SIDE} rows and columns at most"
        )
    # A twelfth of a cell looks right in small labyrinths; two pixels survive the way to 64 x 64.
    usual = max(PICTURE_SIZE // (12 * most), 2 if PICTURE_SIZE // most >= 4 else 1)
    thickness = usual if wall_pixels is None else min(wall_pixels, usual)
    span = PICTURE_SIZE - thickness

    def lines(count: int) -> tuple[int, ...]:
        margin = (span - count * span // most) // 2
        return tuple(margin + line * span // most for line in range(count + 1))

    return _Grid(columns=lines(width), rows=lines(height), thickness=thickness)


@lru_cache(maxsize=4_096)
def _line(grid: _Grid, style: Style, passages: int) -> Strip:
    """Return the strip of a horizontal wall; `passages` is the bit set of columns it is open in."""
    floor, wall = bytes(style.floor), bytes(style.wall)
    columns = len(grid.columns) - 1
    between = [(floor if passages >> c & 1 else wall) * grid.wide(c) for c in range(columns)]
    return KeptStrip([(grid.pixels(wall, between, floor, 0), grid.thickness)])


@lru_cache(maxsize=8_192)
def _tiles(grid: _Grid, style: Style, tall: int, codes: tuple[int, ...], passages: int) -> Strip:
    """Return the strip of a row of cells, without the walls above and below it."""
    floor, wall = bytes(style.floor), bytes(style.wall)
    squares = [_squares(style, code) for code in codes]
    insets = {tall * twelfths // 12 for nested in squares for twelfths, _ in nested}
    borders = sorted(insets | {tall - inset for inset in insets})
    bands: list[Band] = []
    for top, bottom in pairwise(borders):
        between = [
            _tile_row(nested, grid.wide(column), tall, top) for column, nested in enumerate(squares)
        ]
        bands.append((grid.pixels(wall, between, floor, passages), bottom - top))
    return KeptStrip(bands)


def _tile_row(squares: list[tuple[int, Colour]], wide: int, tall: int, y: int) -> bytes:
    """Return the pixels of one tile at height `y`: nested squares, the outermost first."""
    pixels = b""
    for twelfths, colour in squares:
        if tall * twelfths // 12 <= y < tall - tall * twelfths // 12:
            inset = wide * twelfths // 12
            middle = bytes(colour) * (wide - 2 * inset)
            pixels = pixels[: 3 * inset] + middle + pixels[3 * (wide - inset) :]
    return pixels


def _squares(style: Style, code: int) -> list[tuple[int, Colour]]:
    """Return the squares that a cell shows, as (inset in twelfths of a cell, colour)."""
    agent, tile = code & ~7, code & 7
    squares = [(0, style.floor)]
    if tile == _KEY:
        squares += [(3, style.wall), (4, style.key)]
    elif tile == _OPEN_DOOR:
        squares += [(0, style.door), (1, style.floor)]
    elif tile != _FLOOR:
        colours = {
            _START: style.start,
            _GOAL: style.goal,
            _DOOR: style.door,
            _ICE: style.ice,
            _HIDDEN: style.hidden,
        }
        squares += [(0, colours[tile])]
    if agent:
        squares += [(2, style.agent)]
    if agent == _AGENT_WITH_KEY:
        squares += [(4, style.key)]
    return squares


def area_average(picture: NDArray[np.uint8], image_size: int) -> NDArray[np.uint8]:
    """Return a square picture at another size, each pixel the rounded mean of what it covers.

    Args:
        picture: Shape (side, side, 3).
        image_size: Side of the result, shape (image_size, image_size, 3).
    """
    if len(picture) == image_size:
        return picture
    differs = (picture[1:] != picture[:-1]).any(axis=(1, 2))
    first = np.flatnonzero(np.concatenate(([True], differs)))
    counts = np.diff(first, append=len(picture))
    narrowed = np.stack([_narrow(row.tobytes(), image_size) for row in picture[first]])
    return _shorten(narrowed, counts, image_size)


@lru_cache(maxsize=64)
def _coverage(source: int, target: int) -> NDArray[np.float64]:
    """Return how much of each source pixel a target pixel covers, shape (target, source).

    In whole numbers that add up to `source` for every target pixel, so sums are exact.
    """
    starts, targets = np.arange(source) * target, np.arange(target)[:, None] * source
    overlap = np.minimum(starts + target, targets + source) - np.maximum(starts, targets)
    coverage: NDArray[np.float64] = np.maximum(overlap, 0).astype(np.float64)
    return coverage


@lru_cache(maxsize=16_384)
def _narrow(row: bytes, image_size: int) -> NDArray[np.float64]:
    """Return a row of pixels at another width, times its old width, shape (image_size * 3,)."""
    pixels = np.frombuffer(row, np.uint8).reshape(-1, 3).astype(np.float64)
    narrowed: NDArray[np.float64] = _coverage(len(pixels), image_size) @ pixels
    return narrowed.reshape(-1)


def _shorten(
    rows: NDArray[np.float64], counts: NDArray[np.int64], image_size: int
) -> NDArray[np.uint8]:
    """Return the picture of narrowed rows, row i repeated `counts[i]` times, at its new height."""
    height = int(counts.sum())
    starts = np.cumsum(counts) - counts
    weights = np.add.reduceat(_coverage(height, image_size), starts, axis=1)
    total = weights @ rows
    area = height * height
    return ((2 * total + area) // (2 * area)).astype(np.uint8).reshape(image_size, image_size, 3)

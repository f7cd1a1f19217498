"""Draw the picture of a state: flat colours on a grid with black walls.

Everything is made of upright rectangles, so a picture consists of a few distinct rows of pixels,
each repeated; this makes the encoder in `png` fast. Cells are square, whatever the shape of the
labyrinth. `StatePictures` keeps the PNG files of a labyrinth's states, which datasets have.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import accumulate, pairwise

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.checks import whole
from labyrinth_core.pictures.png import (
    PICTURE_SIZE,
    Band,
    KeptStrip,
    Mosaic,
    PictureDigest,
    Strip,
    encode,
    strips_in,
)
from labyrinth_core.pictures.resize import shrink
from labyrinth_core.pictures.style import Colour, Style, style_for, usual_wall_pixels
from labyrinth_core.world import TILES, Labyrinth, State

# The code of what a cell shows, plus one of the last two for an agent.
FLOOR, START, GOAL, OPEN_DOOR, HIDDEN = range(5)
CODE_OF = {tile.name: code for code, tile in enumerate(TILES, start=HIDDEN + 1)}
CODES = HIDDEN + 1 + len(TILES)
KEY, DOOR = CODE_OF["key"], CODE_OF["door"]
AGENT, AGENT_WITH_KEY = 64, 128

AGENT_INSET = 2
"""How far the agent's square is from the walls, in twelfths of a cell."""

REMEMBERED_BYTES = 32 << 20
"""The size of the cache of a labyrinth's pictures; it holds 1,200 at 100x100."""


def render(
    labyrinth: Labyrinth,
    state: State,
    image_size: int = PICTURE_SIZE,
    style: Style | None = None,
) -> NDArray[np.uint8]:
    """Return the image of a state, uint8, shape (image_size, image_size, 3), rows from the top.

    The image is drawn at `PICTURE_SIZE` and area-averaged to other sizes. The default style is that
    of the labyrinth's look.

    Raises:
        ValueError: The labyrinth is too large for every wall to have a pixel, or `image_size` is
            not an integer from 1 to `PICTURE_SIZE`.
    """
    return Painter(labyrinth, style).array(state, image_size)


class Painter:
    """Draws the states of one labyrinth, and draws what they have in common only once."""

    def __init__(self, labyrinth: Labyrinth, style: Style | None = None) -> None:
        structure = labyrinth.structure
        self._labyrinth = labyrinth
        if style is None:
            style = style_for(labyrinth.look, structure.height, structure.width)
        self._style = style
        self._grid = grid_of(structure.height, structure.width, style.wall_pixels)
        everything = (1 << structure.width) - 1
        shifts = range(0, structure.cells, structure.width)
        # The open passages of each row of cells, as bit sets over columns.
        self._right = [structure.right >> shift & everything for shift in shifts]
        self._up = [structure.up >> shift & everything for shift in shifts]
        # The codes of cells, except for cells that show the floor.
        self._codes = {labyrinth.start: START, labyrinth.goal: GOAL}
        self._codes |= {cell: CODE_OF[name] for name, cell in labyrinth.tiles()}
        # The strips above the lowest row of cells: all other rows, their walls, perhaps a margin.
        self._lowest = 2 * structure.height - 1 + (self._grid.top > 0)

    def png(self, state: State, image_size: int = PICTURE_SIZE) -> bytes:
        """Return the picture of a state as a PNG file.

        Raises:
            ValueError: `image_size` is not an integer from 1 to `PICTURE_SIZE`.
        """
        if image_size == PICTURE_SIZE:
            return encode(self.strips(state), PICTURE_SIZE)
        return encode(strips_in(self.array(state, image_size)), image_size)

    def array(self, state: State, image_size: int = PICTURE_SIZE) -> NDArray[np.uint8]:
        """Return the picture of a state, shape (image_size, image_size, 3).

        Raises:
            ValueError: `image_size` is not an integer from 1 to `PICTURE_SIZE`.
        """
        return shrink(self.strips(state), whole("image_size", image_size, 1, PICTURE_SIZE))

    def strips(self, state: State | None = None) -> list[Strip]:
        """Return the picture as strips, from top to bottom, for `png.encode`.

        Args:
            state: The state to show; None for the whole labyrinth without the agent.
        """
        changes = {} if state is None else self.changes(state)
        if self._labyrinth.task.rules.hides and changes:
            return list(changes.values())
        strips = self._strips.copy()
        for index, strip in changes.items():
            strips[index] = strip
        return strips

    @cached_property
    def _strips(self) -> list[Strip]:
        """The strips of the whole labyrinth without the agent."""
        return self._draw(self._codes, self._right, self._up)

    def changes(self, state: State) -> dict[int, Strip]:
        """Return the strips that differ in a state, by index among the labyrinth's strips."""
        labyrinth = self._labyrinth
        cell, has_key, door_open = state
        codes: dict[int, int] = {}
        if has_key and labyrinth.key is not None:
            codes[labyrinth.key] = FLOOR
        if door_open and labyrinth.door is not None:
            codes[labyrinth.door] = OPEN_DOOR
        under = codes.get(cell, self._codes.get(cell, FLOOR))
        codes[cell] = under + (AGENT_WITH_KEY if has_key and not door_open else AGENT)
        if labyrinth.task.rules.hides:
            return dict(enumerate(self._draw_seen(state, self._codes | codes)))
        strips: dict[int, Strip] = {}
        for cell, code in codes.items():
            row, column = divmod(cell, labyrinth.structure.width)
            index = self._lowest - 2 * row
            strip = strips.get(index, self._strips[index])
            strips[index] = _with_tile(self._grid, self._style, strip, column, code)
        return strips

    def _draw_seen(self, state: State, codes: dict[int, int]) -> list[Strip]:
        """Return all strips as the agent sees them; passages out of sight are drawn as walls."""
        labyrinth = self._labyrinth
        seen = labyrinth.structure.visible_from(state.agent)
        shown = seen | {labyrinth.start, labyrinth.goal}
        hidden = dict.fromkeys(set(range(labyrinth.structure.cells)) - shown, HIDDEN)
        rows = [0] * labyrinth.structure.height
        for cell in seen:
            row, column = divmod(cell, labyrinth.structure.width)
            rows[row] |= 1 << column
        right = [open_ & (row | row >> 1) for open_, row in zip(self._right, rows, strict=True)]
        up = [
            open_ & (row | above)
            for open_, row, above in zip(self._up, rows, [*rows[1:], 0], strict=True)
        ]
        return self._draw(codes | hidden, right, up)

    def _draw(self, codes: dict[int, int], right: list[int], up: list[int]) -> list[Strip]:
        """Return all strips, given the codes of cells and the open passages of each row.

        Cells without a code show the floor.
        """
        grid, style = self._grid, self._style
        margin, width = bytes(style.floor) * PICTURE_SIZE, self._labyrinth.structure.width
        strips: list[Strip] = [((margin, grid.top),)] if grid.top else []
        for row in range(len(right) - 1, -1, -1):
            shown = [codes.get(cell, FLOOR) for cell in range(row * width, (row + 1) * width)]
            strips.append(_line(grid, style, up[row]))
            strips.append(_tiles(grid, style, grid.tall(row), tuple(shown), right[row]))
        strips.append(_line(grid, style, 0))
        if grid.bottom:
            strips.append(((margin, grid.bottom),))
        return strips


class StatePictures(dict[State, tuple[bytes, bytes]]):
    """A cache of the pictures of a labyrinth's states, each drawn when it is first needed.

    A value is the PNG file and the digest of its pixels: see `PictureDigest`.
    """

    def __init__(self, labyrinth: Labyrinth) -> None:
        super().__init__()
        self._painter = Painter(labyrinth)
        strips = self._painter.strips()
        self._mosaic, self._digests = Mosaic(strips, PICTURE_SIZE), PictureDigest(strips)

    def __missing__(self, state: State) -> tuple[bytes, bytes]:
        (png,), (digest,) = self.draw([state])
        if len(self) * len(png) >= REMEMBERED_BYTES:
            self.clear()
        self[state] = png, digest
        return png, digest

    def draw(self, states: Sequence[State]) -> tuple[Sequence[bytes], Sequence[bytes]]:
        """Return the PNG files and the digests of states, without keeping them."""
        changes = list(map(self._painter.changes, states))
        return list(map(self._mosaic.encode, changes)), list(map(self._digests.digest, changes))


@dataclass(frozen=True, eq=False)
class Grid:
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
        """Return the number of pixels between the walls above and below a row of cells."""
        above = len(self.rows) - 2 - row
        return self.rows[above + 1] - self.rows[above] - self.thickness

    @cached_property
    def wide(self) -> list[int]:
        """The number of pixels between the walls left and right of each column."""
        return [right - left - self.thickness for left, right in pairwise(self.columns)]

    def choose(self, passages: int, closed: bytes, opened: bytes) -> list[bytes]:
        """Return `opened` for each column whose bit is set in `passages`, else `closed`."""
        columns = range(len(self.columns) - 1)
        return [opened if passages >> column & 1 else closed for column in columns]

    def pixels(self, style: Style, between: list[bytes], walls: list[bytes]) -> bytes:
        """Return a row of pixels, given the pixels between walls and the wall after each column."""
        floor, left = bytes(style.floor), self.columns[0]
        right = PICTURE_SIZE - self.columns[-1] - self.thickness
        parts = [floor * left, bytes(style.wall) * self.thickness]
        for cell, wall in zip(between, walls, strict=True):
            parts += cell, wall
        return b"".join([*parts, floor * right])


# How many rows per second the build writes at 5x5 without a cache: 0.8 times as many without that
# of `_line`, 0.55 without `_tiles`, 0.65 without `_with_tile`; 0.5 without `grid_of`, since then
# the others never hit. Drawing whole rows anew instead of exchanging a tile: 0.77 at 25x25.


@lru_cache(maxsize=64)
def grid_of(height: int, width: int, wall_pixels: int | None = None) -> Grid:
    """Return the positions of walls in labyrinths of a size; see `Style` for their thickness.

    Raises:
        ValueError: The labyrinth is too large for every wall to have a pixel, or `wall_pixels` is
            not a positive integer.
    """
    most, usual = max(height, width), usual_wall_pixels(height, width)
    thickest = max(usual, PICTURE_SIZE // (4 * most))
    thickness = usual
    if wall_pixels is not None:
        thickness = min(whole("wall_pixels", wall_pixels, 1), thickest)
    span = PICTURE_SIZE - thickness

    def lines(count: int) -> tuple[int, ...]:
        margin = (span - count * span // most) // 2
        return tuple(margin + line * span // most for line in range(count + 1))

    return Grid(columns=lines(width), rows=lines(height), thickness=thickness)


@lru_cache(maxsize=4_096)
def _line(grid: Grid, style: Style, passages: int) -> Strip:
    """Return the strip of a horizontal wall; `passages` is the bit set of its openings."""
    floor, wall = bytes(style.floor), bytes(style.wall)
    colours = grid.choose(passages, wall, floor)
    between = [colour * wide for colour, wide in zip(colours, grid.wide, strict=True)]
    posts = [wall * grid.thickness] * len(between)
    return KeptStrip([(grid.pixels(style, between, posts), grid.thickness)])


@lru_cache(maxsize=8_192)
def _tiles(grid: Grid, style: Style, tall: int, codes: tuple[int, ...], passages: int) -> Strip:
    """Return the strip of a row of cells, without the walls above and below it."""
    walls = grid.choose(passages, *(bytes(c) * grid.thickness for c in (style.wall, style.floor)))
    cells = list(zip(codes, grid.wide, strict=True))
    insets = {tall * twelfths // 12 for code in set(codes) for twelfths, _ in squares(style, code)}
    upper: list[Band] = []
    for top, bottom in pairwise([*sorted(insets), tall - max(insets)]):
        looks = {cell: _tile_row(style, *cell, tall, top) for cell in set(cells)}
        row = grid.pixels(style, [looks[cell] for cell in cells], walls)
        upper.append((row, bottom - top))
    # Nested squares are centred, so the lower half mirrors the upper.
    return KeptStrip(upper + upper[-2::-1])


@lru_cache(maxsize=8_192)
def _with_tile(grid: Grid, style: Style, strip: Strip, column: int, code: int) -> Strip:
    """Return the strip of a row of cells after changing the code of one cell."""
    left, wide = 3 * (grid.columns[column] + grid.thickness), grid.wide[column]
    right = left + 3 * wide
    bottoms = list(accumulate(count for _, count in strip))
    tall = bottoms[-1]
    insets = {tall * twelfths // 12 for twelfths, _ in squares(style, code)}
    borders = sorted(insets.union([tall - inset for inset in insets], bottoms))
    bands: list[Band] = []
    rows = iter(zip((row for row, _ in strip), bottoms, strict=True))
    row, end = next(rows)
    for top, bottom in pairwise(borders):
        if top == end:
            row, end = next(rows)
        tile = _tile_row(style, code, wide, tall, top)
        changed = row if row[left:right] == tile else row[:left] + tile + row[right:]
        if bands and bands[-1][0] == changed:
            bands[-1] = (changed, bands[-1][1] + bottom - top)
        else:
            bands.append((changed, bottom - top))
    return KeptStrip(bands)


@lru_cache(maxsize=4_096)
def _tile_row(style: Style, code: int, wide: int, tall: int, y: int) -> bytes:
    """Return the pixels of one tile at height `y`: nested squares, the outermost first."""
    pixels = b""
    for twelfths, colour in squares(style, code):
        if tall * twelfths // 12 <= y < tall - tall * twelfths // 12:
            inset = wide * twelfths // 12
            middle = bytes(colour) * (wide - 2 * inset)
            pixels = pixels[: 3 * inset] + middle + pixels[3 * (wide - inset) :]
    return pixels


@lru_cache(maxsize=256)
def squares(style: Style, code: int) -> list[tuple[int, Colour]]:
    """Return the squares that a cell shows, as (inset in twelfths of a cell, colour)."""
    agent, tile = code & (AGENT | AGENT_WITH_KEY), code & (AGENT - 1)
    shown = {CODE_OF[each.name]: [(0, getattr(style, each.name))] for each in TILES} | {
        FLOOR: [],
        START: [(0, style.start)],
        GOAL: [(0, style.goal)],
        KEY: [(3, style.wall), (4, style.key)],
        OPEN_DOOR: [(0, style.door), (1, style.floor)],
        HIDDEN: [(0, style.hidden)],
    }
    nested = [(0, style.floor), *shown[tile]]
    if agent:
        nested += [(AGENT_INSET, style.agent)]
    if agent == AGENT_WITH_KEY:
        nested += [(4, style.key)]
    return nested

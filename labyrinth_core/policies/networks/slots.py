"""Pictures as anonymous slots: where each colour is, but not which colour it is.

This is what the network of `method=mapper` is shown, cell by cell.

A slot is the set of pixels of one colour. Slots are numbered by where they first appear, from the
top left, so that a picture in any other palette of as many colours has the same slots, to the bit.

A cell is `CELL` blocks high and wide, however many pixels that is. A `Scene` says of each block
which slots have a pixel in it, so that it looks almost alike at all sizes of labyrinths and at all
thicknesses of walls.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

CELL = 12
"""The number of blocks on each side of a cell."""
MOST_SLOTS = 16
"""The most colours that a picture may have; those of this project have at most ten."""

Scene = NDArray[np.uint16]
"""Which slots each block shows, as a bit set, shape (CELL * height, CELL * width)."""


class Slots(NamedTuple):
    """The slots of a picture of `side` pixels each way.

    Most rows of pixels equal the one above, and are kept once.
    """

    lines: NDArray[np.uint8]
    """The slot of each pixel in each different row of pixels, from the top, shape (R, side)."""
    rows: NDArray[np.int64]
    """Which of these each row is, ascending, shape (side,)."""
    colours: NDArray[np.uint32]
    """The colour of each slot, as one number, shape (K,)."""


def slots_of(picture: NDArray[np.uint8]) -> Slots:
    """Return the slots of a picture of shape (side, side, 3).

    Raises:
        ValueError: It has more than `MOST_SLOTS` colours, as a picture that was shrunk has.
    """
    new = np.ones(len(picture), np.bool_)
    new[1:] = (picture[1:] != picture[:-1]).any(axis=(1, 2))
    red, green, blue = np.moveaxis(picture[new].astype(np.uint32), 2, 0)
    pixels = (red << 16 | green << 8 | blue).reshape(-1)
    starts = np.flatnonzero(np.diff(pixels, prepend=~pixels[:1]))  # Of runs of equal pixels.
    colours, first, which = np.unique(pixels[starts], return_index=True, return_inverse=True)
    if len(colours) > MOST_SLOTS:
        raise ValueError(
            f"a picture has {len(colours)} colours: show pictures of flat colours, {MOST_SLOTS} at "
            "most, as image_size=600 has them"
        )
    order = first.argsort()
    numbers = order.argsort().astype(np.uint8)
    lines = numbers[which].repeat(np.diff(starts, append=len(pixels)))
    return Slots(lines.reshape(-1, picture.shape[1]), new.cumsum() - 1, colours[order])


def scene_of(slots: Slots, height: int, width: int) -> Scene:
    """Return which slots each block shows.

    Args:
        slots: The slots of a picture.
        height: The number of rows of the labyrinth, whose cells are square and in the middle.
        width: The number of columns.
    """
    blocks = CELL * max(height, width)
    bounds = np.arange(blocks) * len(slots.rows) // blocks
    bits = np.left_shift(1, slots.lines, dtype=np.uint16)
    lines = np.bitwise_or.reduceat(bits, bounds, axis=1)
    scene: Scene = np.bitwise_or.reduceat(lines[slots.rows], bounds, axis=0)
    top, left = (blocks // 2 - CELL * cells // 2 for cells in (height, width))
    return scene[top : top + CELL * height, left : left + CELL * width]


def coarsened(scene: Scene, side: int) -> Scene:
    """Return which slots each square of `side` blocks on a side shows."""
    rows, columns = (np.arange(0, length, side) for length in scene.shape)
    found: Scene = np.bitwise_or.reduceat(np.bitwise_or.reduceat(scene, rows, 0), columns, 1)
    return found


def cell_of_colour(slots: Slots, colour: int, height: int, width: int) -> int:
    """Return the cell in the middle of a colour, counted from the top left, row by row.

    A colour that is not in the picture counts as in its middle.

    Args:
        slots: The slots of a picture.
        colour: As in `Slots`.
        height: The number of rows of the labyrinth.
        width: The number of columns.
    """
    side, most = len(slots.rows), max(height, width)
    mask = (slots.colours == colour)[slots.lines]
    cell = 0
    for along, cells in ((mask.any(axis=1)[slots.rows], height), (mask.any(axis=0), width)):
        there = np.flatnonzero(along)
        middle = int(there[0] + there[-1] + 1) if there.size else side
        place = (middle * most - (most - cells) * side) // (2 * side)
        cell = cell * cells + min(max(place, 0), cells - 1)
    return cell


def shifted(slots: Slots, down: int, right: int) -> Slots:
    """Return slots moved by some pixels; those at the border are repeated."""
    places = np.arange(len(slots.rows))
    rows, columns = ((places - by).clip(0, len(places) - 1) for by in (down, right))
    return slots._replace(lines=slots.lines[:, columns], rows=slots.rows[rows])


def grown(slots: Slots, slot: int, by: int) -> Slots:
    """Return slots of which one has grown by some pixels in all directions, over the others."""
    side = len(slots.rows)
    mask = np.pad(slots.lines == slot, ((0, 1), (by, by)))  # One more line, for `reduceat`.
    wide = np.lib.stride_tricks.sliding_window_view(mask, 2 * by + 1, axis=1).any(axis=2)
    places = np.arange(side)
    above, below = ((places + each).clip(0, side - 1) for each in (-by, by))
    ranges = np.stack([slots.rows[above], slots.rows[below] + 1, slots.rows], axis=1)
    new = np.ones(side, np.bool_)
    new[1:] = (ranges[1:] != ranges[:-1]).any(axis=1)
    covered = np.logical_or.reduceat(wide, ranges[new, :2].reshape(-1), axis=0)[::2]
    lines = np.where(covered, np.uint8(slot), slots.lines[ranges[new, 2]])
    return slots._replace(lines=lines, rows=new.cumsum() - 1)


def masks_of(scenes: NDArray[np.uint16]) -> Tensor:
    """Return whether each block shows each slot, shape (N, K, rows, columns), from bit sets."""
    count = int(scenes.max(initial=1)).bit_length()
    bits = np.arange(count, dtype=np.uint16)[:, None, None]
    return torch.from_numpy((scenes[:, None] >> bits & 1).astype(np.float32))


def places_of(masks: Tensor) -> Tensor:
    """Return how each slot is spread over the cells, shape (N, K, cells); each adds up to 1."""
    shares: Tensor = patches_of(masks).sum((3, 4))
    return shares / shares.sum(2, keepdim=True).clamp(min=1)


def patches_of(blocks: Tensor) -> Tensor:
    """Return the blocks of each cell, shape (N, K, cells, CELL, CELL).

    Args:
        blocks: Any K numbers a block, shape (N, K, rows of blocks, columns of blocks).
    """
    tall: Tensor = blocks.unflatten(3, (-1, CELL)).unflatten(2, (-1, CELL))
    return tall.transpose(3, 4).flatten(2, 3)


class Surroundings(NamedTuple):
    """What is around the cells of N pictures, without what moves."""

    others: Tensor
    """The masks without what moves, and with a margin of a cell, shape (N, K, rows, columns)."""
    free: Tensor
    """1 where what moves would not cover what is there, if it were in the middle of three by three
    cells, shape (N, 3 * CELL, 3 * CELL)."""

    @classmethod
    def of(cls, masks: Tensor, movers: Tensor) -> Surroundings:
        """Return the surroundings in pictures in which some slots, shape (N,), are what moves."""
        pictures = torch.arange(len(masks), device=masks.device)
        where = places_of(masks)[pictures, movers].argmax(1)
        body = patches_of(masks)[pictures, movers, where]
        others = masks.clone()
        others[pictures, movers] = 0
        margin = (CELL,) * 4
        return cls(functional.pad(others, margin), 1 - functional.pad(body, margin))

    @property
    def grid(self) -> tuple[int, int]:
        """The numbers of rows and columns."""
        rows, columns = (blocks // CELL - 2 for blocks in self.others.shape[2:])
        return rows, columns

    def at(self, pictures: Tensor, cells: Tensor) -> Tensor:
        """Return three by three cells around some, as if what moves were there.

        Args:
            pictures: The number of a picture for each cell, shape (M,).
            cells: The cells, shape (M,).

        Returns:
            Shape (M, K, 3 * CELL, 3 * CELL).
        """
        windows = self.others.unfold(2, 3 * CELL, CELL).unfold(3, 3 * CELL, CELL)
        rows, columns = cells // self.grid[1], cells % self.grid[1]
        return windows[pictures, :, rows, columns] * self.free[pictures, None]

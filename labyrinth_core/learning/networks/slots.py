"""Pictures as anonymous slots: where each colour is, but not which colour it is.

This is the input of the network of `method=mapper`, cell by cell.

A slot is the set of pixels of one colour. Slots are numbered in the order of their first pixels,
from the top left, so a picture in any other palette of as many colours has bit-identical slots.

A cell is `CELL` blocks high and wide, however many pixels that is. A `Scene` holds the slots that
have a pixel in each block, so it is almost the same for all sizes of labyrinths and thicknesses of
walls.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

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

    Runs of equal rows or columns of pixels, which are most of a picture, are stored once.
    """

    grid: NDArray[np.uint8]
    """The slot of each pixel in the R distinct rows and C distinct columns, shape (R, C)."""
    rows: NDArray[np.int64]
    """The index in `grid` of each row of pixels, ascending, shape (side,)."""
    columns: NDArray[np.int64]
    """The index in `grid` of each column of pixels, ascending, shape (side,)."""
    colours: NDArray[np.uint32]
    """The colour of each slot, as one number, shape (K,)."""

    @classmethod
    def of(cls, picture: NDArray[np.uint8]) -> Slots:
        """Return the slots of a picture of shape (side, side, 3).

        Raises:
            ValueError: The picture has more than `MOST_SLOTS` colours, as resized pictures do.
        """
        rows = _different(picture.reshape(len(picture), -1))
        red, green, blue = np.moveaxis(picture[rows].astype(np.uint32), 2, 0)
        pixels = red << 16 | green << 8 | blue
        columns = _different(pixels.T)
        pixels = pixels[:, columns]
        colours, first, which = np.unique(pixels, return_index=True, return_inverse=True)
        if len(colours) > MOST_SLOTS:
            raise ValueError(
                f"a picture has {len(colours)} colours, more than {MOST_SLOTS}: show pictures of "
                "flat colours, as with image_size=600"
            )
        order = first.argsort()
        grid = order.argsort().astype(np.uint8)[which].reshape(pixels.shape)
        return cls(grid, rows.cumsum() - 1, columns.cumsum() - 1, colours[order])

    def scene(self, height: int, width: int, cell: int = CELL) -> Scene:
        """Return the slots in each block, as a bit set.

        Args:
            height: The number of rows of the labyrinth, which is centred and has square cells.
            width: The number of columns.
            cell: The number of blocks on each side of a cell.
        """
        blocks, side = cell * max(height, width), len(self.rows)
        bounds = np.arange(blocks + 1) * side // blocks
        ends = np.maximum(bounds[1:] - 1, bounds[:-1])  # Blocks may be smaller than a pixel.
        scene = np.zeros([length + 1 for length in self.grid.shape], np.uint16)
        np.left_shift(1, self.grid, out=scene[:-1, :-1], dtype=np.uint16)
        rows, columns = (
            np.stack([lines[bounds[:-1]], lines[ends] + 1], axis=1).reshape(-1)
            for lines in (self.rows, self.columns)
        )
        scene = np.bitwise_or.reduceat(scene, rows, 0)[::2]
        scene = np.bitwise_or.reduceat(scene, columns, 1)[:, ::2]
        top, left = (blocks // 2 - cell * cells // 2 for cells in (height, width))
        return scene[top : top + cell * height, left : left + cell * width]

    def cell_of(self, colour: int, height: int, width: int) -> int:
        """Return the cell at the middle of a colour, counted from the top left, row by row.

        If the picture lacks the colour, return the cell at the middle of the picture.

        Args:
            colour: As in `Slots`.
            height: The number of rows of the labyrinth.
            width: The number of columns.
        """
        side, most = len(self.rows), max(height, width)
        mask = (self.colours == colour)[self.grid]
        along = mask.any(axis=1)[self.rows], mask.any(axis=0)[self.columns]
        cell = 0
        for pixels, cells in zip(map(np.flatnonzero, along), (height, width), strict=True):
            middle = int(pixels[0] + pixels[-1] + 1) if pixels.size else side
            index = (middle * most - (most - cells) * side) // (2 * side)
            cell = cell * cells + min(max(index, 0), cells - 1)
        return cell

    def shifted(self, down: int, right: int) -> Slots:
        """Return slots moved by some pixels; pixels at the border are repeated."""
        places = np.arange(len(self.rows))
        rows, columns = ((places - by).clip(0, len(places) - 1) for by in (down, right))
        return self._replace(rows=self.rows[rows], columns=self.columns[columns])

    def grown(self, slot: int, by: int) -> Slots:
        """Return slots after growing one by some pixels in all directions, over the others."""
        # The number of the slot's entries above and left of each corner of the grid.
        before = np.zeros([length + 1 for length in self.grid.shape], np.int32)
        (self.grid == slot).cumsum(0, np.int32).cumsum(1, out=before[1:, 1:])
        (rows, (above, below, down)), (columns, (left, right, along)) = (
            _within(lines, by) for lines in (self.rows, self.columns)
        )
        between = before[below] - before[above]
        covered = between[:, right] > between[:, left]
        grid = np.where(covered, np.uint8(slot), self.grid[down[:, None], along])
        tall, wide = _different(grid), _different(grid.T)
        rows, columns = (tall.cumsum() - 1)[rows], (wide.cumsum() - 1)[columns]
        return self._replace(grid=grid[tall][:, wide], rows=rows, columns=columns)


def _different(lines: NDArray[Any]) -> NDArray[np.bool_]:
    """Return which lines differ from the line before, shape (lines,); True for the first."""
    new = np.ones(len(lines), np.bool_)
    new[1:] = (lines[1:] != lines[:-1]).any(axis=1)
    return new


def _within(lines: NDArray[np.int64], by: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the distinct ranges of lines within `by` pixels of each pixel.

    Args:
        lines: The line of each pixel, ascending, shape (side,).
        by: The number of pixels.

    Returns:
        The range of each pixel, ascending, shape (side,); and for each range the first line, the
        line after the last, and the pixel's own line, shape (3, ranges).
    """
    pixels = np.arange(len(lines))
    first, last = (lines[(pixels + shift).clip(0, len(lines) - 1)] for shift in (-by, by))
    ranges = np.stack([first, last + 1, lines], axis=1)
    new = _different(ranges)
    return new.cumsum() - 1, ranges[new].T


def masks_of(scenes: NDArray[np.uint16]) -> Tensor:
    """Return whether each block shows each slot, shape (N, K, rows, columns), from bit sets."""
    count = int(scenes.max(initial=1)).bit_length()
    bits = np.arange(count, dtype=np.uint16)[:, None, None]
    return torch.from_numpy((scenes[:, None] >> bits & 1).astype(np.float32))


def places_of(masks: Tensor) -> Tensor:
    """Return the distribution of each slot over the cells, shape (N, K, cells), with sum 1."""
    shares: Tensor = patches_of(masks).sum((3, 4))
    return shares / shares.sum(2, keepdim=True).clamp(min=1)


def patches_of(blocks: Tensor) -> Tensor:
    """Return the blocks of each cell, shape (N, K, cells, CELL, CELL).

    Args:
        blocks: K numbers per block, shape (N, K, rows of blocks, columns of blocks).
    """
    tall: Tensor = blocks.unflatten(3, (-1, CELL)).unflatten(2, (-1, CELL))
    return tall.transpose(3, 4).flatten(2, 3)


class Surroundings(NamedTuple):
    """The surroundings of the cells of N pictures, without the slot that moves."""

    others: Tensor
    """The masks without the slot that moves, padded by one cell, shape (N, K, rows, columns)."""
    free: Tensor
    """1 for each block that the moving slot would not cover if it were in the middle of three by
    three cells, else 0, shape (N, 3 * CELL, 3 * CELL)."""

    @classmethod
    def of(cls, masks: Tensor, movers: Tensor) -> Surroundings:
        """Return the surroundings in pictures whose moving slots are `movers`, shape (N,)."""
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

    def on_ways(self, looks: Tensor, ways: Sequence[tuple[int, int]]) -> Tensor:
        """Return the features between the middle of each cell and the middles of its neighbours.

        The moving slot is assumed to be in the cell.

        Args:
            looks: The L features of each slot, shape (N, K, L).
            ways: W directions to neighbours, as rows down and columns right. Each is turned by a
                quarter more than the one before.

        Returns:
            The maximum of each feature over the slots in a block, and 0 in a block without slots,
            shape (N, cells, W, L, CELL, CELL). A slot of few pixels, such as a thin
            wall, counts in full.
        """
        shown = self.others[:, :, None] > 0
        counts = looks[..., None, None].where(shown, looks.new_tensor(-torch.inf)).amax(1)
        scene = counts.where(shown.any(1), looks.new_zeros(()))
        height, width = (CELL * cells for cells in self.grid)
        windows = []
        for turns, (down, right) in enumerate(ways):
            top, left = CELL + CELL // 2 * down, CELL + CELL // 2 * right
            window = patches_of(scene[:, :, top : top + height, left : left + width])
            free = self.free[:, top : top + CELL, left : left + CELL]
            windows.append(torch.rot90(window * free[:, None, None], turns % 4, (3, 4)))
        return torch.stack(windows, 3).permute(0, 2, 3, 1, 4, 5)

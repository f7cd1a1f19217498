"""What the network of `method=mapper` is shown: pictures as tensors of blocks, cell by cell."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from labyrinth_core.policies.networks.slots import CELL


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

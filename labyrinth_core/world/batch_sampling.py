"""Sample structures from many generators at once, in arrays.

`BatchSampler` draws from each generator what `Structure.sample` would, so a sub-environment gets
the labyrinths of a single environment. Sampling one by one takes ten times as long.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.world.batch import Structures
from labyrinth_core.world.sampling import BLOCK, cells_beside, default_open_walls, twelfths_of


class Drawn(NamedTuple):
    """The result of `BatchSampler.sample`."""

    numbers: NDArray[np.int64]
    """The indices of the generators that gave a structure."""
    structures: Structures
    """Their structures."""
    before: list[Mapping[str, Any]]
    """The states of these generators before the draw."""


class BatchSampler:
    """Samples structures of one size from many generators."""

    MOST_CELLS: ClassVar = 64
    """The largest number of cells whose bit set fits a NumPy integer."""

    def __init__(self, height: int, width: int) -> None:
        """Prepare for structures of `height` rows and `width` columns, at most `MOST_CELLS`."""
        self._height, self._width = height, width
        around = cells_beside(height, width)
        # The neighbour of each cell that each integer from 0 to 11 chooses, shape (12 * cells,).
        self._chosen = np.array([cells[n % len(cells)] for cells in around for n in range(12)])

    def sample(self, generators: Sequence[np.random.Generator]) -> Drawn:
        """Return the first structure that `Structure.sample` yields from each generator.

        A generator is left out, and keeps its state, if it is not NumPy's default one, or if its
        walk is one of the few long ones.
        """
        height, width = self._height, self._width
        cells = height * width
        limit = cells * cells.bit_length() * 3 // 2  # At any size, 96% of walks take no more steps.
        fit, before, words = [], [], []
        for number, generator in enumerate(generators):
            state = generator.bit_generator.state
            if state["bit_generator"] == "PCG64" and not state["has_uint32"]:
                fit.append(number)
                before.append(state)
                # The words that generator.bytes(BLOCK) and random(2 * cells) read, but much faster.
                words.append(generator.bit_generator.random_raw(BLOCK // 8 + 2 * cells))
        raw = np.array(words, np.uint64).reshape(-1, BLOCK // 8 + 2 * cells)
        steps, complete = _twelfths(raw[:, : limit // 8 + 4], limit)
        joined, growing = self._walk(steps)
        complete[growing] = False
        for row in np.flatnonzero(~complete).tolist():
            generators[fit[row]].bit_generator.state = before[row]
        coins = (raw[complete, BLOCK // 8 :] >> 11).reshape(-1, 2, cells) / 2**53
        heads = coins < default_open_walls(height, width)
        structures = _structures(height, width, joined[complete], heads)
        rows = np.flatnonzero(complete)
        numbers = np.array(fit, np.int64)[rows]
        return Drawn(numbers, structures, [before[row] for row in rows.tolist()])

    def _walk(self, steps: NDArray[np.uint8]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return spanning trees from loop-erased random walks, the same walks as in `sampling`.

        Args:
            steps: Integers from 0 to 11, one for each step of each tree, shape (steps, n).

        Returns:
            The cell that each cell of each tree is joined to, itself for the root, shape
            (n, cells), and the numbers of the trees that are not complete after the last step.
        """
        cells, count = self._height * self._width, steps.shape[1]
        bits = np.left_shift(np.uint64(1), np.arange(cells, dtype=np.uint64))
        onward = np.tile(np.arange(cells), count)
        routes = np.zeros(count * cells, np.uint64)
        growing = np.arange(count)
        first = growing * cells
        tree = np.full(count, bits[cells // 2])
        cell, route = np.zeros(count, np.int64), np.full(count, bits[0])
        routes[first] = route
        for draws in steps:
            if not len(growing):
                break
            after = self._chosen.take(12 * cell + draws.take(growing))
            onward[first + cell] = after
            # A route is the set of cells between the start of a walk and a cell. A walk that
            # returns to its route has made a loop and erases it: the route is again what it was at
            # that cell.
            entry, bit = first + after, bits.take(after)
            route = np.where(route & bit, routes.take(entry), route | bit)
            routes[entry], cell = route, after
            arrived = (tree & bit).nonzero()[0]
            if len(arrived):
                tree[arrived] |= route[arrived]
                route[arrived], cell[arrived] = _first_outside(tree[arrived], cells)
                routes[first[arrived] + cell[arrived]] = route[arrived]
                if not route[arrived].all():
                    on = np.flatnonzero(route)
                    growing, first, tree = growing[on], first[on], tree[on]
                    cell, route = cell[on], route[on]
        return onward.reshape(count, cells), growing


def _twelfths(words: NDArray[np.uint64], limit: int) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:
    """Return the first integers from 0 to 11 that each row of words yields.

    Args:
        words: Random words, shape (n, words).
        limit: The number of integers required from each row.

    Returns:
        The integers, shape (limit, n), and whether each row yielded `limit` of them, shape (n,).
    """
    draws = [twelfths_of(row.tobytes())[:limit] for row in words.astype("<u8")]
    padded = b"".join(each.ljust(limit, b"\0") for each in draws)
    steps = np.frombuffer(padded, np.uint8).reshape(-1, limit).T
    return steps.copy(), np.array([len(each) == limit for each in draws], np.bool_)


def _first_outside(
    trees: NDArray[np.uint64], cells: int
) -> tuple[NDArray[np.uint64], NDArray[np.int64]]:
    """Return the first cell that each tree lacks, as a set and as a number.

    A tree that has all cells gets the empty set and the number 0.
    """
    outside = ~trees & np.uint64((1 << cells) - 1)
    first = outside & -outside
    return first, np.frexp(np.maximum(first, 1).astype(np.float64))[1].astype(np.int64) - 1


def _structures(
    height: int, width: int, joined: NDArray[np.int64], opened: NDArray[np.bool_]
) -> Structures:
    """Return the structures of trees after further walls are opened.

    Args:
        height: Rows.
        width: Columns.
        joined: The cell that each cell of each tree is joined to, shape (n, cells).
        opened: Whether to open the wall above and right of each cell, shape (n, 2, cells).
    """
    steps = joined - np.arange(height * width)
    up, right = steps == width, steps == 1
    up[:, :-width] |= steps[:, width:] == -width
    right[:, :-1] |= steps[:, 1:] == -1
    up |= opened[:, 0]
    right |= opened[:, 1]
    up[:, -width:] = False
    right[:, width - 1 :: width] = False
    return Structures(height, width, up, right)

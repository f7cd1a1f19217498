"""Spanning trees by the thousand: the algorithms of `sampling`, in numpy, a step of all at a time.

Each gives every tree the probability that it has there.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.world.sampling import ALGORITHMS, Draws, cells_beside

Integers = NDArray[np.int64]
Passages = tuple[NDArray[np.bool_], NDArray[np.bool_]]
"""Whether each cell has a passage to the cell above, and to the cell at the right, both
(n, cells)."""

WORD = 64
"""The largest number of cells of which numpy holds a set in one integer."""


def _passages(width: int, joined: Integers) -> Passages:
    """Return the passages from each cell to the one that it is joined to, itself for none."""
    steps = joined - np.arange(joined.shape[1])
    up, right = steps == width, steps == 1
    up[:, :-width] |= steps[:, width:] == -width
    right[:, :-1] |= steps[:, 1:] == -1
    return up, right


def _wilson(height: int, width: int, count: int, rng: np.random.Generator) -> Passages:
    cells = height * width
    if cells > WORD:  # A walk in Python takes no longer then.
        draws, joined = Draws(rng), np.tile(np.arange(cells), (count, 1))
        for tree in joined:
            edges = ALGORITHMS["wilson"](cells_beside(height, width), draws)
            tree[[cell for cell, _ in edges]] = [after for _, after in edges]
        return _passages(width, joined)

    def draw(_: int, walks: Integers) -> NDArray[np.uint8]:
        return rng.integers(12, size=len(walks), dtype=np.uint8)

    return walk_together(height, width, count, draw)[0]


def walk_together(
    height: int,
    width: int,
    count: int,
    draw: Callable[[int, Integers], NDArray[np.uint8]],
    limit: int | None = None,
) -> tuple[Passages, Integers]:
    """Return trees made of loop-erased random walks, step by step those of `sampling`.

    Args:
        height: Rows.
        width: Columns; of no more than `WORD` cells.
        count: The number of trees.
        draw: Gives each walk an integer from 0 to 11; its arguments are the number of the step
            and the numbers of the trees whose walks are not over.
        limit: The number of steps to end at.

    Returns:
        The passages of all trees, and the numbers of those that are not complete at the limit.
    """
    cells = height * width
    beside = _chosen_neighbours(height, width)
    bits = np.left_shift(np.uint64(1), np.arange(cells, dtype=np.uint64))
    onward = np.tile(np.arange(cells), count)
    routes = np.zeros(count * cells, np.uint64)
    growing = np.arange(count)
    first = growing * cells
    tree = np.full(count, bits[cells // 2])
    cell, route = np.zeros(count, np.int64), np.full(count, bits[0])
    routes[first] = route
    step = 0
    while len(growing) and step != limit:
        after = beside.take(12 * cell + draw(step, growing))
        onward[first + cell] = after
        # A route is the set of cells between the start of a walk and a cell. A walk that comes
        # back to its route has gone in a loop, and forgets it: the route is as it was there.
        place, bit = first + after, bits.take(after)
        route = np.where(route & bit, routes.take(place), route | bit)
        routes[place], cell = route, after
        arrived = (tree & bit).nonzero()[0]
        if len(arrived):
            tree[arrived] |= route[arrived]
            route[arrived], cell[arrived] = _first_outside(tree[arrived], cells)
            routes[first[arrived] + cell[arrived]] = route[arrived]
            if not route[arrived].all():
                on = np.flatnonzero(route)
                growing, first, tree = growing[on], first[on], tree[on]
                cell, route = cell[on], route[on]
        step += 1
    return _passages(width, onward.reshape(count, cells)), growing


def _first_outside(trees: NDArray[np.uint64], cells: int) -> tuple[NDArray[np.uint64], Integers]:
    """Return the first cell that each tree lacks, as a set and as a number; none of all is 0."""
    outside = ~trees & np.uint64((1 << cells) - 1)
    first = outside & -outside
    return first, np.frexp(np.maximum(first, 1).astype(np.float64))[1].astype(np.int64) - 1


def _chosen_neighbours(height: int, width: int) -> Integers:
    """Return the neighbour of each cell that each integer from 0 to 11 chooses, (12 * cells,)."""
    around = cells_beside(height, width)
    return np.array([cells[each % len(cells)] for cells in around for each in range(12)])


def _depth_first(height: int, width: int, count: int, rng: np.random.Generator) -> Passages:
    cells = height * width
    beside, choices = _padded_neighbours(height, width), _choices()
    growing = np.arange(count)
    first = growing * (cells + 1)
    seen = np.zeros(count * (cells + 1), np.bool_)
    seen[first + cells] = True  # What the padding stands for.
    joined = np.tile(np.arange(cells + 1), count)
    cell = rng.integers(cells, size=count)
    seen[first + cell] = True
    left = np.full(count, cells - 1)
    while len(growing):
        free = ~seen[first[:, None] + beside[cell]]
        which = np.packbits(free, axis=1, bitorder="little")[:, 0]
        choice = choices[which, rng.integers(12, size=len(growing), dtype=np.uint8)]
        after = beside[cell, choice]
        back = which == 0
        after[back] = joined[(first + cell)[back]]
        on = np.flatnonzero(which)
        places = first[on] + after[on]
        seen[places], joined[places] = True, cell[on]
        cell = after
        left[on] -= 1
        if not left[on].all():
            on = np.flatnonzero(left)
            growing, first, cell, left = growing[on], first[on], cell[on], left[on]
    return _passages(width, joined.reshape(count, cells + 1)[:, :cells])


def _padded_neighbours(height: int, width: int) -> Integers:
    """Return the neighbours of each cell, filled up with the number of cells, shape (cells, 4)."""
    cells = height * width
    return np.array([[*each, *[cells] * (4 - len(each))] for each in cells_beside(height, width)])


def _choices() -> Integers:
    """Return which of four an integer from 0 to 11 chooses among those in a set, (16, 12)."""
    sets = [[each for each in range(4) if number >> each & 1] or [0] for number in range(16)]
    return np.array([[each[draw % len(each)] for draw in range(12)] for each in sets])


def _kruskal(height: int, width: int, count: int, rng: np.random.Generator) -> Passages:
    cells = height * width
    edges = [
        (a, b) for a, around in enumerate(cells_beside(height, width)) for b in around if a < b
    ]
    ends = np.array(edges)
    order = rng.permuted(np.tile(np.arange(len(edges)), (count, 1)), axis=1)
    part = np.tile(np.arange(cells, dtype=np.int16 if cells < 1 << 15 else np.int64), (count, 1))
    passages = np.zeros((2, count, cells), np.bool_)
    trees = np.arange(count)
    for edge in order.T:
        a, b = ends[edge].T
        part_a, part_b = part[trees, a], part[trees, b]
        passages[(b - a == 1).astype(np.int64), trees, a] |= part_a != part_b
        np.copyto(part, part_a[:, None], where=part == part_b[:, None])
    return passages[0], passages[1]


def _prim(height: int, width: int, count: int, rng: np.random.Generator) -> Passages:
    """The tree of the quickest ways from a random cell, where each edge takes a random time.

    If the times are exponentially distributed, whichever edge of the border is chosen next is
    uniform, as the time that is left does not depend on the time that is over.
    """
    times = rng.exponential(size=(2, count, height, width))
    reached = np.full((count, height, width), np.inf)
    row, column = np.divmod(rng.integers(height * width, size=count), width)
    reached[np.arange(count), row, column] = 0
    borders = [
        (reached[:, :-1], reached[:, 1:], times[0, :, :-1]),
        (reached[:, :, :-1], reached[:, :, 1:], times[1, :, :, :-1]),
    ]
    before = np.zeros_like(reached)
    while (before != reached).any():
        before = reached.copy()
        for one, other, time in borders:
            np.minimum(other, one + time, out=other)
            np.minimum(one, other + time, out=one)
    passages = np.zeros(times.shape, np.bool_)
    for (one, other, time), open_ in zip(
        borders, (passages[0, :, :-1], passages[1, :, :, :-1]), strict=True
    ):
        open_[:] = (one + time == other) | (other + time == one)
    up, right = passages.reshape(2, count, height * width)
    return up, right


BATCH_ALGORITHMS: dict[str, Callable[[int, int, int, np.random.Generator], Passages]] = {
    "wilson": _wilson,
    "depth_first": _depth_first,
    "kruskal": _kruskal,
    "prim": _prim,
}
"""The ways to draw many random spanning trees, by the names that they have in `sampling`."""

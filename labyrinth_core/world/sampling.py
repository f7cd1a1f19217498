"""Draw random spanning trees of a grid, to which `Structure.sample` adds passages at random.

Only Wilson's algorithm gives every spanning tree the same probability. Opening walls afterwards
makes every connected structure possible.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache
from itertools import chain, compress, repeat

import numpy as np

Edge = tuple[int, int]

Neighbours = Sequence[Sequence[int]]
"""The neighbours of each cell, regardless of walls, in the order of the actions."""

BLOCK = 4096
"""The number of bytes that are drawn at a time."""

_TWELFTHS = bytes(byte % 12 for byte in range(256))
_UNFAIR = bytes(range(252, 256))
"""The bytes from 252, the largest multiple of 12, on; the others are uniform modulo 12."""


def twelfths_of(block: bytes) -> bytes:
    """Turn uniform bytes into uniform integers from 0 to 11, dropping about 2% of the bytes."""
    return block.translate(_TWELFTHS, _UNFAIR)


class Draws:
    """The two sources of randomness of the tree algorithms: a generator, and small integers."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.rng = rng
        self.twelfths = chain.from_iterable(twelfths_of(rng.bytes(BLOCK)) for _ in repeat(None))
        """Uniform integers from 0 to 11; their remainders modulo 2, 3 and 4 are uniform, too."""


@lru_cache(maxsize=1)  # For environments, which draw one at a time: 1.1 ms, not 1.6, at 25x25.
def cells_beside(height: int, width: int) -> Neighbours:
    """Return the neighbours of each cell, regardless of walls, in the order of the actions."""
    beside = []
    for cell in range(height * width):
        row, column = divmod(cell, width)
        inside = row + 1 < height, column + 1 < width, row > 0, column > 0
        beside.append([cell + step for step in compress((width, 1, -width, -1), inside)])
    return beside


def default_open_walls(height: int, width: int) -> float:
    """Return the share of non-tree walls that are open in the original datasets.

    Measured on these datasets: about 12% at 3x3, 9% at 4x4 and 8% at 5x5. Other sizes get 8%.
    """
    return {9: 0.12, 16: 0.09}.get(height * width if height == width else 0, 0.08)


def _wilson(beside: Neighbours, draws: Draws) -> list[Edge]:
    """Loop-erased random walks; Wilson, "Generating random spanning trees", STOC 1996."""
    cells, twelfths = len(beside), draws.twelfths
    onward = [-1] * cells
    in_tree = [False] * cells
    in_tree[cells // 2] = True  # Any root will do; from the middle the first walks are short.
    tree = []
    for start in range(cells):
        cell = start
        while not in_tree[cell]:
            # Leaving a cell again overwrites its exit, which erases the loop.
            around = beside[cell]
            onward[cell] = cell = around[next(twelfths) % len(around)]
        cell = start
        while not in_tree[cell]:
            in_tree[cell] = True
            tree.append((cell, onward[cell]))
            cell = onward[cell]
    return tree


def _depth_first(beside: Neighbours, draws: Draws) -> list[Edge]:
    """Randomised depth-first search: long corridors, few branches."""
    seen = [False] * len(beside)
    stack = [int(draws.rng.integers(len(beside)))]
    tree = []
    while stack:
        cell = stack[-1]
        seen[cell] = True
        fresh = [neighbour for neighbour in beside[cell] if not seen[neighbour]]
        if fresh:
            stack.append(fresh[next(draws.twelfths) % len(fresh)])
            tree.append((cell, stack[-1]))
        else:
            stack.pop()
    return tree


def _kruskal(beside: Neighbours, draws: Draws) -> list[Edge]:
    """Randomised Kruskal: each edge, in random order, is kept if it joins two parts."""
    edges = [
        (cell, neighbour)
        for cell, around in enumerate(beside)
        for neighbour in around
        if neighbour > cell
    ]
    parent = list(range(len(beside)))

    def root(cell: int) -> int:
        while parent[cell] != cell:
            parent[cell] = cell = parent[parent[cell]]
        return cell

    tree = []
    for index in draws.rng.permutation(len(edges)).tolist():
        a, b = (root(cell) for cell in edges[index])
        if a != b:
            parent[a] = b
            tree.append(edges[index])
    return tree


def _prim(beside: Neighbours, draws: Draws) -> list[Edge]:
    """Randomised Prim: the tree grows by a random edge of its border; short dead ends."""
    seen = [False] * len(beside)
    cell = int(draws.rng.integers(len(beside)))
    seen[cell] = True
    border = [(cell, neighbour) for neighbour in beside[cell]]
    tree = []
    while border:
        pick = int(draws.rng.random() * len(border))
        border[pick], border[-1] = border[-1], border[pick]
        edge = border.pop()
        if not seen[edge[1]]:
            seen[edge[1]] = True
            tree.append(edge)
            border.extend((edge[1], cell) for cell in beside[edge[1]] if not seen[cell])
    return tree


ALGORITHMS: dict[str, Callable[[Neighbours, Draws], list[Edge]]] = {
    "wilson": _wilson,
    "depth_first": _depth_first,
    "kruskal": _kruskal,
    "prim": _prim,
}
"""Name in the configuration -> algorithm that draws a random spanning tree."""

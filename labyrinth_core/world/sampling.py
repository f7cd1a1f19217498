"""Sample random structures: draw a spanning tree, then open further walls at random.

Only Wilson's algorithm gives every spanning tree the same probability. Opening walls afterwards
makes every connected structure possible.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import lru_cache
from itertools import chain, repeat

import numpy as np

from labyrinth_core.world.grid import (
    bit_set,
    checked_sides,
    horizontal_edges,
    neighbours,
    vertical_edges,
)

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


def sample_passages(
    height: int,
    width: int,
    rng: np.random.Generator,
    algorithm: str,
    open_walls: float | None,
) -> Iterator[tuple[int, int]]:
    """Yield `up` and `right` of random structures; the arguments are those of `Structure.sample`.

    Raises:
        ValueError: As for `Structure.sample`.
    """
    height, width = checked_sides(height, width)
    if algorithm not in ALGORITHMS:
        raise ValueError(f"sampler={algorithm}: choose one of {', '.join(ALGORITHMS)}")
    if open_walls is None:
        open_walls = default_open_walls(height, width)
    if not 0 <= open_walls <= 1:
        raise ValueError(f"open_walls={open_walls}: give a probability from 0 to 1")
    draw_tree = ALGORITHMS[algorithm]
    cells = height * width
    beside = cells_beside(height, width)
    edges = vertical_edges(height, width) | horizontal_edges(height, width) << cells
    draws = Draws(rng)
    while True:
        digits = ["0"] * (2 * cells)  # First the passages up, then the passages to the right.
        for a, b in draw_tree(beside, draws):
            digits[min(a, b) + (0 if abs(b - a) == width else cells)] = "1"
        is_open = bit_set("".join(digits))
        if open_walls:
            coins = np.packbits(rng.random(2 * cells) < open_walls, bitorder="little")
            is_open |= edges & int.from_bytes(coins.tobytes(), "little")
        yield is_open & (1 << cells) - 1, is_open >> cells


@lru_cache(maxsize=1)  # For environments, which draw one at a time: 1.1 ms, not 1.6, at 25x25.
def cells_beside(height: int, width: int) -> Neighbours:
    """Return the neighbours of each cell, regardless of walls, in the order of the actions."""
    return [list(neighbours(cell, height, width).values()) for cell in range(height * width)]


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

"""Random structures: a spanning tree by one of several algorithms, then further walls opened.

Only Wilson's algorithm gives every spanning tree the same probability; with some walls opened
after it, every connected structure can come up.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import lru_cache

import numpy as np

from labyrinth_core.grid import horizontal_edges, neighbours, vertical_edges
from labyrinth_core.labyrinth import Structure

Edge = tuple[int, int]

_TWELFTHS = bytes(byte % 12 for byte in range(256))
_UNFAIR = bytes(range(252, 256))
"""Bytes left out so that the rest, modulo 12, is uniform."""


class Draws:
    """A generator's randomness in the forms that drawing a tree needs."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.rng = rng
        self.twelfths = self._twelfths()
        """Uniform whole numbers from 0 to 11: modulo 2, 3 or 4, fair choices of a neighbour."""

    def _twelfths(self) -> Iterator[int]:
        while True:
            yield from self.rng.bytes(4096).translate(_TWELFTHS, _UNFAIR)


def sample_structure(
    height: int,
    width: int,
    rng: np.random.Generator,
    *,
    algorithm: str = "wilson",
    open_walls: float | None = None,
) -> Structure:
    """Return a random connected structure; see `sample_structures`."""
    return next(sample_structures(height, width, rng, algorithm=algorithm, open_walls=open_walls))


def sample_structures(
    height: int,
    width: int,
    rng: np.random.Generator,
    *,
    algorithm: str = "wilson",
    open_walls: float | None = None,
) -> Iterator[Structure]:
    """Yield random connected structures without end; the same one may come again.

    Args:
        height: Rows.
        width: Columns.
        rng: Where all randomness comes from.
        algorithm: How the spanning tree is drawn, a key of `ALGORITHMS`.
        open_walls: Probability of opening each wall that the tree leaves;
            None for `default_open_walls`.

    Raises:
        ValueError: There is no such algorithm, or no such probability.
    """
    if algorithm not in ALGORITHMS:
        raise ValueError(f"sampler={algorithm}: choose one of {', '.join(ALGORITHMS)}")
    if open_walls is None:
        open_walls = default_open_walls(height, width)
    if not 0 <= open_walls <= 1:
        raise ValueError(f"open_walls={open_walls}: give a probability from 0 to 1")
    draw_tree = ALGORITHMS[algorithm]
    draws = Draws(rng)
    cells = height * width
    all_up, all_right = vertical_edges(height, width), horizontal_edges(height, width)
    while True:
        up, right = _passages(height, width, draw_tree(height, width, draws))
        if open_walls:
            coins = np.packbits(rng.random(2 * cells) < open_walls, bitorder="little")
            opened = int.from_bytes(coins.tobytes(), "little")
            up |= opened & all_up
            right |= opened >> cells & all_right
        yield Structure(height, width, up, right)


def default_open_walls(height: int, width: int) -> float:
    """Return the share of walls off the tree that the original's published sets have open.

    About 12% at 3x3, 9% at 4x4 and 8% at 5x5, measured on them; 8% for every other size.
    """
    return {9: 0.12, 16: 0.09}.get(height * width if height == width else 0, 0.08)


def _passages(height: int, width: int, tree: list[Edge]) -> tuple[int, int]:
    """Return the bit sets of a `Structure` for a list of passages."""
    up, right = bytearray(b"0") * (height * width), bytearray(b"0") * (height * width)
    for a, b in tree:
        low = a if a < b else b
        if a - b in (1, -1):
            right[-1 - low] = 49  # "1"; the last character is cell 0.
        else:
            up[-1 - low] = 49
    return int(up, 2), int(right, 2)


@lru_cache(maxsize=16)
def _grid_neighbours(height: int, width: int) -> list[list[int]]:
    """Return the neighbours of each cell, as if there were no walls."""
    return [list(neighbours(cell, height, width).values()) for cell in range(height * width)]


@lru_cache(maxsize=16)
def _twelve_neighbours(height: int, width: int) -> list[list[int]]:
    """Return the neighbours of each cell, repeated to make twelve, so that a draw picks one."""
    return [beside * (12 // len(beside)) for beside in _grid_neighbours(height, width)]


def _wilson(height: int, width: int, draws: Draws) -> list[Edge]:
    """Loop-erased random walks; Wilson, "Generating random spanning trees", STOC 1996."""
    beside = _twelve_neighbours(height, width)
    twelfths = draws.twelfths
    cells = height * width
    onward = [-1] * cells
    in_tree = bytearray(cells)
    in_tree[cells // 2] = 1  # Any root will do; from the middle the first walks are short.
    tree = []
    for start in range(cells):
        if in_tree[start]:
            continue
        cell = start
        while not in_tree[cell]:
            # Walking on from a cell a second time forgets the loop made since the first.
            onward[cell] = cell = beside[cell][next(twelfths)]
        cell = start
        while not in_tree[cell]:
            in_tree[cell] = 1
            tree.append((cell, onward[cell]))
            cell = onward[cell]
    return tree


def _depth_first(height: int, width: int, draws: Draws) -> list[Edge]:
    """Randomised depth-first search: long corridors, few branches."""
    beside = _grid_neighbours(height, width)
    seen = bytearray(height * width)
    stack = [int(draws.rng.integers(height * width))]
    seen[stack[0]] = 1
    tree = []
    while stack:
        cell = stack[-1]
        fresh = [neighbour for neighbour in beside[cell] if not seen[neighbour]]
        if not fresh:
            stack.pop()
            continue
        chosen = fresh[next(draws.twelfths) % len(fresh)]
        seen[chosen] = 1
        tree.append((cell, chosen))
        stack.append(chosen)
    return tree


def _kruskal(height: int, width: int, draws: Draws) -> list[Edge]:
    """Randomised Kruskal: edges in random order, each kept that joins two parts."""
    edges = [
        (cell, neighbour)
        for cell, beside in enumerate(_grid_neighbours(height, width))
        for neighbour in beside
        if neighbour > cell
    ]
    parent = list(range(height * width))

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


def _prim(height: int, width: int, draws: Draws) -> list[Edge]:
    """Randomised Prim: a tree that grows by a random edge on its border; short dead ends."""
    beside = _grid_neighbours(height, width)
    seen = bytearray(height * width)
    cell = int(draws.rng.integers(height * width))
    seen[cell] = 1
    border = [(cell, neighbour) for neighbour in beside[cell]]
    tree = []
    while border:
        pick = int(draws.rng.random() * len(border))
        border[pick], border[-1] = border[-1], border[pick]
        edge = border.pop()
        if not seen[edge[1]]:
            seen[edge[1]] = 1
            tree.append(edge)
            border.extend((edge[1], cell) for cell in beside[edge[1]] if not seen[cell])
    return tree


ALGORITHMS: dict[str, Callable[[int, int, Draws], list[Edge]]] = {
    "wilson": _wilson,
    "depth_first": _depth_first,
    "kruskal": _kruskal,
    "prim": _prim,
}
"""Ways to draw a spanning tree, by the name they have in the configuration."""

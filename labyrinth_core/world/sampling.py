"""Random structures: a spanning tree by one of several algorithms, then further walls opened.

Only Wilson's algorithm gives every spanning tree the same probability; with some walls opened
after it, every connected structure can come up.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import lru_cache
from itertools import chain

import numpy as np

from labyrinth_core.world.grid import Action, horizontal_edges, neighbours, vertical_edges
from labyrinth_core.world.labyrinth import Structure

Edge = tuple[int, int]

_TWELFTHS = bytes(byte % 12 for byte in range(256))
_UNFAIR = bytes(range(252, 256))
"""Bytes left out so that the rest, modulo 12, is uniform."""

_NOT_UP, _NOT_RIGHT, _NOT_DOWN, _NOT_LEFT = (0b1111 ^ 1 << action for action in Action)


class Draws:
    """A generator's randomness in the forms that drawing a tree needs."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.rng = rng
        self.twelfths = chain.from_iterable(self._blocks())
        """Uniform whole numbers from 0 to 11: modulo 2, 3 or 4, fair choices of a neighbour."""

    def _blocks(self) -> Iterator[bytes]:
        while True:
            yield self.rng.bytes(4096).translate(_TWELFTHS, _UNFAIR)


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
    edges = vertical_edges(height, width) | horizontal_edges(height, width) << cells
    all_cells = (1 << cells) - 1
    while True:
        open_edges = _edge_set(height, width, draw_tree(height, width, draws))
        if open_walls:
            coins = np.packbits(rng.random(2 * cells) < open_walls, bitorder="little")
            open_edges |= int.from_bytes(coins.tobytes(), "little") & edges
        yield Structure(height, width, open_edges & all_cells, open_edges >> cells)


def default_open_walls(height: int, width: int) -> float:
    """Return the share of walls off the tree that the original's published sets have open.

    About 12% at 3x3, 9% at 4x4 and 8% at 5x5, measured on them; 8% for every other size.
    """
    return {9: 0.12, 16: 0.09}.get(height * width if height == width else 0, 0.08)


def _edge_set(height: int, width: int, tree: list[Edge]) -> int:
    """Return the bit sets `up` and `right` of a `Structure` for a list of passages, as one."""
    cells = height * width
    digits = bytearray(b"0") * (2 * cells)
    # The last digit is that of the passage up from cell 0; each belongs to its smaller cell.
    place = {width: -1, -width: width - 1, 1: -1 - cells, -1: -cells}
    for a, b in tree:
        digits[place[b - a] - a] = 49  # "1"
    return int(digits, 2)


@lru_cache(maxsize=16)
def _grid_neighbours(height: int, width: int) -> list[list[int]]:
    """Return the neighbours of each cell, as if there were no walls."""
    return [list(neighbours(cell, height, width).values()) for cell in range(height * width)]


@lru_cache(maxsize=16)
def _twelve_neighbours(height: int, width: int) -> list[list[int]]:
    """Return the neighbours of each cell, repeated to make twelve, so that a draw picks one."""
    return [beside * (12 // len(beside)) for beside in _grid_neighbours(height, width)]


@lru_cache(maxsize=16)
def _sides(height: int, width: int) -> bytes:
    """Return for each cell on which sides there is another, a bit for each action there."""
    grid = (neighbours(cell, height, width) for cell in range(height * width))
    return bytes(sum(1 << action for action in beside) for beside in grid)


@lru_cache(maxsize=16)
def _twelve_steps(width: int) -> list[list[int]]:
    """Return for each set of sides the steps in index to those cells, repeated to make twelve."""
    steps = {Action.UP: width, Action.RIGHT: 1, Action.DOWN: -width, Action.LEFT: -1}
    open_sides = [[steps[a] for a in Action if sides >> a & 1] for sides in range(16)]
    return [to * (12 // len(to)) if to else to for to in open_sides]


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
    # Sides with a cell not seen; more at the end for the neighbours that border cells lack.
    fresh = bytearray(_sides(height, width)) + bytes(width)
    steps, twelfths = _twelve_steps(width), draws.twelfths
    cell = int(draws.rng.integers(height * width))
    stack, tree = [cell], list[Edge]()
    while True:
        fresh[cell + width] &= _NOT_DOWN
        fresh[cell + 1] &= _NOT_LEFT
        fresh[cell - width] &= _NOT_UP
        fresh[cell - 1] &= _NOT_RIGHT
        while not fresh[cell]:
            stack.pop()
            if not stack:
                return tree
            cell = stack[-1]
        step = steps[fresh[cell]][next(twelfths)]
        tree.append((cell, cell + step))
        cell += step
        stack.append(cell)


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

"""Structures of one size compared as bits: which are equal when turned, which a few walls apart.

The search for structures a few walls apart is exact, and takes almost linear time.

The distance of two structures of one size is the number of passages that only one of them has.
Cut the passages of the grid into blocks: structures that are at most `walls` apart differ in at
most `walls` blocks, and agree in all others. So for each choice of `walls` blocks, the passages
outside them are a key: structures that share no key are farther apart, and those that share one
are compared in full. (Manku, Jain and Das Sarma, "Detecting near-duplicates for web crawling",
WWW 2007, section 3.)
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import combinations
from math import comb
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.world import Structure, Structures

JOINED_WALLS = 3
"""The largest distance found by looking up keys; for larger ones all pairs are compared."""
MOST_PAIRS = 10**10
"""The maximum number of pairs compared; at 5x5 that takes about half a minute."""
FAR = -1
"""A distance of more than `JOINED_WALLS`, unknown as there are too many pairs to compare."""

HELD_PAIRS = 1 << 20
"""The number of pairs held in memory at a time."""
_ONES = np.array([byte.bit_count() for byte in range(256)], np.uint8)

Planes = tuple[NDArray[np.bool_], NDArray[np.bool_], NDArray[np.bool_]]
"""Passages up (n, height - 1, width) and right (n, height, width - 1), marks (n, m, height, width).

Axes of the grid: row 0 at the bottom, column 0 at the left.
"""


class Nearest(NamedTuple):
    """For each structure, the nearest of some others."""

    walls: NDArray[np.int64]
    """The distance of the nearest, `FAR` if unknown, shape (structures,)."""
    which: NDArray[np.int64]
    """The index of the nearest, the first if tied, shape (structures,); meaningless where `FAR`."""


def passage_table(structures: Sequence[Structure]) -> NDArray[np.bool_]:
    """Return which passages are open, shape (structures, passages of the grid).

    The passages that lead up come first, by cell, and then those that lead right.

    Args:
        structures: At least one, all of one size.
    """
    grid = Structure.without_walls(structures[0].height, structures[0].width)
    each, there = Structures.of(structures), Structures.of([grid])
    up, right = each.up[:, there.up[0]], each.right[:, there.right[0]]
    passages: NDArray[np.bool_] = np.concatenate([up, right], axis=1)
    return passages


def canonical_keys(
    height: int, width: int, passages: NDArray[np.bool_], cells: NDArray[np.int64] | None
) -> list[bytes]:
    """Return a key for each structure, the same for all its rotations and reflections.

    Args:
        height: Rows of all structures.
        width: Columns.
        passages: As `passage_table` gives them, shape (n, passages).
        cells: Marked cells, shape (n, m). If given, equal keys mean that one symmetry maps both
            the structure and the cells.
    """
    count, vertical = len(passages), (height - 1) * width
    marks = np.zeros((count, 0 if cells is None else cells.shape[1], height * width), np.bool_)
    if cells is not None:
        np.put_along_axis(marks, cells[:, :, None], True, axis=2)
    planes = (
        passages[:, :vertical].reshape(count, height - 1, width),
        passages[:, vertical:].reshape(count, height, width - 1),
        marks.reshape(count, -1, height, width),
    )
    least: NDArray[Any] | None = None
    for image in _images(planes):
        if image[2].shape[2] <= image[2].shape[3]:
            flat = np.concatenate([plane.reshape(count, -1) for plane in image], axis=1)
            packed = np.packbits(flat, axis=1)
            key = packed.view(f"S{packed.shape[1]}")[:, 0]
            least = key if least is None else np.where(key < least, key, least)
    assert least is not None
    keys: list[bytes] = least.tolist()
    return keys


def _images(planes: Planes) -> Iterator[Planes]:
    """Yield the eight rotations and reflections, the given one first, as `Structure.symmetries`."""
    up, right, marks = planes
    for turn in range(8):
        yield up, right, marks
        if turn % 2:  # Left and right exchanged.
            up, right, marks = up[..., ::-1], right[..., ::-1], marks[..., ::-1]
        else:  # Rows and columns exchanged.
            up, right = right.swapaxes(1, 2), up.swapaxes(1, 2)
            marks = marks.swapaxes(2, 3)


def nearest(of: NDArray[np.bool_], among: NDArray[np.bool_]) -> Nearest:
    """Return the nearest structure of `among` for each of `of`; exact unless it is `FAR`.

    Args:
        of: A `passage_table`, shape (n, passages).
        among: A `passage_table` for structures of the same size, shape (m, passages), m at least 1.
    """
    # Distance and index in one number, the distance first: the least is the nearest.
    best = np.full(len(of), np.iinfo(np.int64).max)
    packed_of, packed_among = np.packbits(of, axis=1), np.packbits(among, axis=1)
    for queries, others in _candidates(of, among, JOINED_WALLS):
        walls = _ONES[packed_of[queries] ^ packed_among[others]].sum(axis=1, dtype=np.int64)
        starts = np.flatnonzero(np.diff(queries, prepend=-1))
        found = np.minimum.reduceat(walls * len(among) + others, starts)
        best[queries[starts]] = np.minimum(best[queries[starts]], found)
    walls, which = np.divmod(best, len(among))
    far = np.flatnonzero(walls > JOINED_WALLS)
    if len(far) * len(among) <= MOST_PAIRS:
        walls[far], which[far] = _nearest_of_all(of[far], among)
    else:
        walls[far], which[far] = FAR, 0
    return Nearest(walls, which)


def _candidates(
    of: NDArray[np.bool_], among: NDArray[np.bool_], walls: int
) -> Iterator[tuple[NDArray[np.int64], NDArray[np.int64]]]:
    """Yield candidate pairs (indices in `of`, indices in `among`), some of them repeatedly.

    They include all pairs at most `walls` apart; the indices in `of` are in ascending order.
    """
    blocks, left_out = _cut(of.shape[1], walls, len(among))
    # A key is the sum of a random number for each open passage, so the sums of blocks add up.
    numbers = np.random.default_rng(0).integers(2**64, size=(of.shape[1],), dtype=np.uint64)
    sums_of, sums_among = (
        np.stack([np.matmul(table[:, block], numbers[block]) for block in blocks], axis=1)
        for table in (of, among)
    )
    for without in left_out:
        kept = [number for number in range(len(blocks)) if number not in without]
        keys = sums_of[:, kept].sum(axis=1)
        held = sums_among[:, kept].sum(axis=1)
        order = np.argsort(held, kind="stable")
        held = held[order]
        first = np.searchsorted(held, keys, side="left")
        counts = np.searchsorted(held, keys, side="right") - first
        ends = np.cumsum(counts)
        start = 0
        while start < len(of) and ends[-1]:
            done = ends[start - 1] if start else 0
            # At least one structure, however many share its key.
            stop = max(int(np.searchsorted(ends, done + HELD_PAIRS, side="right")), start + 1)
            queries = np.repeat(np.arange(start, stop), counts[start:stop])
            if len(queries):
                offsets = np.arange(len(queries)) + done - (ends - counts)[queries]
                yield queries, order[first[queries] + offsets]
            start = stop


def _cut(
    passages: int, walls: int, structures: int
) -> tuple[list[NDArray[np.int64]], list[tuple[int, ...]]]:
    """Return blocks of passages, and each choice of `walls` blocks to leave out.

    With more blocks there are more keys, but longer ones, which fewer structures share by chance.
    """

    def cost(blocks: int) -> float:
        # A passage of a random structure carries about 0.7 bits, measured at 5x5.
        shared_by_chance: float = structures * 2.0 ** (-0.7 * passages * (blocks - walls) / blocks)
        # Comparing a pair takes about a tenth of the time of making and looking up a key.
        return comb(blocks, walls) * (1 + shared_by_chance / 10)

    most = max(walls + 1, min(passages, walls + 8))
    blocks = min(range(walls + 1, most + 1), key=cost)
    parts = [np.arange(number, passages, blocks) for number in range(blocks)]
    return parts, list(combinations(range(blocks), walls))


def _nearest_of_all(of: NDArray[np.bool_], among: NDArray[np.bool_]) -> Nearest:
    """Return the nearest by comparing all pairs."""
    walls, which = np.empty(len(of), np.int64), np.empty(len(of), np.int64)
    # |a xor b| = |a| + |b| - 2 a.b; float32 is exact for integers below 2 ** 24.
    others = among.astype(np.float32)
    of_others = others.sum(axis=1)
    step = max(1, 16 * HELD_PAIRS // len(among))
    for start in range(0, len(of), step):
        some = of[start : start + step].astype(np.float32)
        apart = some @ others.T
        apart *= -2
        apart += of_others
        at = apart.argmin(axis=1)
        which[start : start + step] = at
        walls[start : start + step] = apart[np.arange(len(some)), at] + some.sum(axis=1)
    return Nearest(walls, which)


class Neighbourhood:
    """A collection of structures of one size that tells whether another one is near one of them."""

    def __init__(self, height: int, width: int, walls: int, structures: int) -> None:
        """Create an empty collection.

        Args:
            height: The number of rows.
            width: The number of columns.
            walls: The largest distance that counts as near.
            structures: The approximate number of structures to add; it affects only the speed.
        """
        self._walls = walls
        self._shift = height * width
        every = Structure.without_walls(height, width)
        grid = every.up | every.right << self._shift
        places = [bit for bit in range(grid.bit_length()) if grid >> bit & 1]
        blocks, left_out = _cut(len(places), walls, structures)
        cut = [sum(1 << places[passage] for passage in block) for block in blocks]
        masks = [grid - sum(cut[number] for number in without) for without in left_out]
        self._tables: list[tuple[int, dict[int, list[int]]]] = [(mask, {}) for mask in masks]

    def add(self, structure: Structure) -> None:
        """Add a structure."""
        bits = structure.up | structure.right << self._shift
        for mask, table in self._tables:
            table.setdefault(bits & mask, []).append(bits)

    def is_near(self, structure: Structure) -> bool:
        """Return whether an added structure is at most `walls` away from this one."""
        bits = structure.up | structure.right << self._shift
        return any(
            (bits ^ other).bit_count() <= self._walls
            for mask, table in self._tables
            for other in table.get(bits & mask, ())
        )

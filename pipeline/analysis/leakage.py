"""The certificate of leakage: what the labyrinths of two splits have in common, counted exactly.

Everything is found by looking up keys that are equal where something is in common, so that the
time grows with the number of labyrinths and not of pairs; `near_twins` has those a few walls
apart, `symmetry` those that a rotation or reflection makes the same.
"""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from math import inf
from statistics import median
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.data.columns import SAMPLED_SPLITS, SPLITS
from labyrinth_core.language.text import labyrinth_id
from labyrinth_core.world.labyrinth import Labyrinth
from labyrinth_core.world.near_twins import FAR, JOINED_WALLS, nearest, passage_table
from labyrinth_core.world.solver import shortest_routes
from pipeline.analysis.symmetry import canonical_keys

NEAR = range(1, JOINED_WALLS + 1)
"""Walls that near twins are counted by."""

ROUTES = 1_000
"""Optimal routes of a labyrinth that are compared, at most."""

_DERIVED = [split for split in SPLITS if split not in SAMPLED_SPLITS]

Found = Mapping[str, str]
"""Id of a labyrinth of the second split -> that of the first such labyrinth of the first split."""


@dataclass(frozen=True)
class Pair:
    """What the labyrinths of a split have in common with those of another."""

    first: str
    second: str
    equal: Found
    """The structures are the same."""
    mirrored: Found
    """Or a rotation or reflection makes the same of them and of their starts and goals."""
    symmetric: Found
    """Or one makes the same of the structures, wherever start and goal are."""
    same_route: Found
    """An optimal route is also an optimal route there."""
    nearest: Mapping[str, tuple[str, int]]
    """Id -> that of the labyrinth with the nearest structure of its size, and the walls between.

    Missing are those that have none of their size, and those that have none near among too many
    to compare (`near_twins.MOST_PAIRS`).
    """

    def within(self, walls: int) -> int:
        """Return how many structures of the second split are so near to one of the first."""
        return sum(apart <= walls for _, apart in self.nearest.values())

    def spread(self, of: int) -> str:
        """Return how many walls the nearest one is away, least and median.

        Args:
            of: Labyrinths of the second split; those that are missing are far away.
        """
        walls = [apart for _, apart in self.nearest.values()]
        values = (min(walls, default=inf), median([*walls, *[inf] * (of - len(walls))]))
        return ", ".join("far" if value == inf else f"{value:g}" for value in values)

    def to_json(self, of: int) -> dict[str, Any]:
        """Return it in plain types, with the counts; `of` as for `spread`."""
        within = {str(walls): self.within(walls) for walls in NEAR}
        return vars(self) | {"within": within, "spread": self.spread(of)}


@dataclass(frozen=True)
class Certificate:
    """What the splits of a dataset have in common."""

    labyrinths: Mapping[str, int]
    """Split -> different labyrinths in it."""
    repeated: Mapping[str, int]
    """Split -> how many of them have the structure of one before."""
    pairs: tuple[Pair, ...]
    """Of the splits with structures of their own."""
    strangers: Mapping[str, Sequence[str]]
    """Split made of the structures of train -> ids of the labyrinths in it with another one."""
    cut: int
    """Labyrinths with more than `ROUTES` optimal routes, of which so many were compared."""

    def to_json(self) -> dict[str, Any]:
        """Return it in plain types."""
        pairs = [pair.to_json(self.labyrinths[pair.second]) for pair in self.pairs]
        return vars(self) | {"pairs": pairs}


def certify(splits: Mapping[str, Iterable[Labyrinth]]) -> Certificate:
    """Return the certificate of a dataset.

    Args:
        splits: The labyrinths of each split. Where there is a train, splits called
            random, s0 and s0_and_g are taken to be made of its structures; all others are
            compared with one another.
    """
    order = [*(split for split in SPLITS if split in splits), *splits]  # What is there comes once.
    held = {split: list(dict.fromkeys(splits[split])) for split in order}
    ids = {split: [labyrinth_id(each) for each in labyrinths] for split, labyrinths in held.items()}
    structures = {split: [each.structure for each in held[split]] for split in held}
    train = set(structures.get("train", []))
    derived = [split for split in held if train and split in _DERIVED]
    compared = [split for split in held if split not in derived]
    known = {split: _Known(ids[split], held[split]) for split in compared}
    return Certificate(
        labyrinths={split: len(labyrinths) for split, labyrinths in held.items()},
        repeated={split: len(each) - len(set(each)) for split, each in structures.items()},
        pairs=tuple(
            _compared(first, known[first], second, known[second])
            for first, second in combinations(compared, 2)
        ),
        strangers={
            split: [
                number
                for number, structure in zip(ids[split], structures[split], strict=True)
                if structure not in train
            ]
            for split in derived
        },
        cut=sum(each.cut for each in known.values()),
    )


class _Known:
    """The labyrinths of a split with the keys by which they are found."""

    def __init__(self, ids: list[str], labyrinths: list[Labyrinth]) -> None:
        self.ids = ids
        self.of_size: dict[tuple[int, int], tuple[list[int], NDArray[np.bool_]]] = {}
        """Height and width -> places of the labyrinths of that size, and their passages."""
        routes = [shortest_routes(each, ROUTES + 1) for each in labyrinths]
        self.cut = sum(len(each) > ROUTES for each in routes)
        self.keys: dict[str, list[Sequence[Hashable]]] = {
            "equal": [[each.structure] for each in labyrinths],
            "mirrored": [[]] * len(ids),
            "symmetric": [[]] * len(ids),
            "same_route": [
                [(*_size(each), each.start, bytes(route)) for route in of_each[:ROUTES]]
                for each, of_each in zip(labyrinths, routes, strict=True)
            ],
        }
        for size in dict.fromkeys(map(_size, labyrinths)):
            places = [place for place, each in enumerate(labyrinths) if _size(each) == size]
            table = passage_table([labyrinths[place].structure for place in places])
            self.of_size[size] = places, table
            ends = np.array([(labyrinths[place].start, labyrinths[place].goal) for place in places])
            for name, marked in {"mirrored": ends, "symmetric": None}.items():
                keys = canonical_keys(*size, table, marked)
                for place, key in zip(places, keys, strict=True):
                    self.keys[name][place] = [key]


def _size(labyrinth: Labyrinth) -> tuple[int, int]:
    return labyrinth.structure.height, labyrinth.structure.width


def _compared(first: str, base: _Known, second: str, other: _Known) -> Pair:
    def found(name: str) -> dict[str, str]:
        """Return who in `other` has a key that somebody in `base` has, and who that is."""
        owner: dict[Hashable, int] = {}
        for place, keys in enumerate(base.keys[name]):
            for key in keys:
                owner.setdefault(key, place)
        pairs = zip(other.ids, other.keys[name], strict=True)
        shared = ((number, [owner[key] for key in keys if key in owner]) for number, keys in pairs)
        return {number: base.ids[min(places)] for number, places in shared if places}

    equal = found("equal")
    mirrored = equal | found("mirrored")
    symmetric = mirrored | found("symmetric")
    nearest = dict(_nearest(base, other))
    return Pair(first, second, equal, mirrored, symmetric, found("same_route"), nearest)


def _nearest(base: _Known, other: _Known) -> Iterator[tuple[str, tuple[str, int]]]:
    for size, (places, table) in other.of_size.items():
        if size in base.of_size:
            held, among = base.of_size[size]
            near = nearest(table, among)
            pairs = zip(places, near.which.tolist(), near.walls.tolist(), strict=True)
            for place, index, walls in pairs:
                if walls != FAR:
                    yield other.ids[place], (base.ids[held[index]], walls)

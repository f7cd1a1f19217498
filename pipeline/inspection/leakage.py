"""The certificate of leakage: what the labyrinths of two splits have in common, counted exactly.

It adds to the certificate of disjointness whatever is alike without being the same. All of it is
found by looking up keys that are equal where something is in common, so that the time grows with
the number of labyrinths and not of pairs; `near_twins` finds those a few walls apart, `symmetry`
those that a rotation or reflection makes the same.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import inf
from statistics import median
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.world.labyrinth import Labyrinth
from labyrinth_core.world.near_twins import FAR, JOINED_WALLS, nearest, passage_table
from labyrinth_core.world.solver import shortest_routes
from pipeline.inspection import certificate as disjointness
from pipeline.inspection.certificate import (
    Found,
    Hashes,
    Held,
    Keys,
    canonical_hashes,
    counterparts,
    ids_of,
    size_of,
    structure_of,
)

NEAR = range(1, JOINED_WALLS + 1)
"""The numbers of walls that near twins are counted by."""

ROUTES = 1_000
"""The largest number of optimal routes of a labyrinth that are compared."""

Route = tuple[int, int, int, bytes]
"""Height and width of the labyrinth, the start, and the actions."""


@dataclass(frozen=True)
class Pair(disjointness.Pair):
    """What the labyrinths of a split have in common with those of another."""

    symmetric: Found
    """These, and those whose structures a rotation or reflection makes the same."""
    same_route: Found
    """An optimal route of the one is an optimal route of the other."""
    nearest: Mapping[str, tuple[str, int]]
    """Id -> id of the labyrinth with the nearest structure of its size, and the walls between.

    Labyrinths are missing if there is none of their size, or none near among too many to compare
    (`near_twins.MOST_PAIRS`).
    """

    def within(self, walls: int) -> int:
        """Return how many labyrinths of the second split are within so many walls of the first."""
        return sum(apart <= walls for _, apart in self.nearest.values())

    def spread(self, of: int) -> str:
        """Return the distance to the nearest structure in walls, least and median.

        Args:
            of: The number of labyrinths of the second split; those that are missing are far away.
        """
        walls = [apart for _, apart in self.nearest.values()]
        values = (min(walls, default=inf), median([*walls, *[inf] * (of - len(walls))]))
        return ", ".join("far" if value == inf else f"{value:g}" for value in values)


@dataclass(frozen=True)
class Certificate(disjointness.Certificate):
    """What the splits of a dataset have in common, and how near they are to one another."""

    pairs: Sequence[Pair]
    cut: int
    """The number of labyrinths with more than `ROUTES` optimal routes, of which so many were
    compared."""

    def to_json(self) -> dict[str, Any]:
        """Return the certificate in plain types, with the counts."""
        pairs = []
        for pair in self.pairs:
            within = {str(walls): pair.within(walls) for walls in NEAR}
            spread = pair.spread(self.labyrinths[pair.second])
            pairs.append(vars(pair) | {"within": within, "spread": spread})
        return vars(self) | {"pairs": pairs}


def certify(
    splits: Mapping[str, Iterable[Held]],
    certificate: disjointness.Certificate | None = None,
    most_routes: int = ROUTES,
) -> Certificate:
    """Return the certificate of a dataset.

    Args:
        splits: The labyrinths of each split, or the structures alone, which have no routes; for
            what the names mean see `certificate.certify`.
        certificate: That of their disjointness, if it is known.
        most_routes: The largest number of optimal routes of a labyrinth that are compared.
    """
    held = {split: list(dict.fromkeys(labyrinths)) for split, labyrinths in splits.items()}
    if certificate is None:
        keys = {split: Keys.of(labyrinths) for split, labyrinths in held.items()}
        certificate = disjointness.certify(keys)
        ids = {split: of_split.labyrinth for split, of_split in keys.items()}
    else:
        ids = {split: ids_of(labyrinths) for split, labyrinths in held.items()}
    known = {
        split: _Known(labyrinths, ids[split], most_routes)
        for split, labyrinths in held.items()
        if split not in certificate.strangers
    }
    pairs = [_compared(pair, known[pair.first], known[pair.second]) for pair in certificate.pairs]
    cut = sum(each.cut for each in known.values())
    return Certificate(**vars(certificate) | {"pairs": pairs, "cut": cut})


class _Known:
    """The labyrinths of a split with the keys by which counterparts are found."""

    def __init__(self, labyrinths: list[Held], ids: Hashes, most_routes: int) -> None:
        self.numbers = ids
        self.ids = [f"{number:016x}" for number in self.numbers]
        self.symmetric = canonical_hashes(labyrinths, with_ends=False)
        found = [_optimal(each, most_routes + 1) for each in labyrinths]
        self.cut = sum(len(each) > most_routes for each in found)
        self.routes = [routes[:most_routes] for routes in found]
        self.of_size: dict[tuple[int, int], tuple[list[int], NDArray[np.bool_]]] = {}
        """Height and width -> indices of the labyrinths of that size, and their passages."""
        for size, places in disjointness.places_by_size(labyrinths).items():
            table = passage_table([structure_of(labyrinths[place]) for place in places])
            self.of_size[size] = places, table


def _optimal(labyrinth: Held, most: int) -> list[Route]:
    """Return the optimal routes of a labyrinth, none of a structure alone."""
    if not isinstance(labyrinth, Labyrinth):
        return []
    routes = shortest_routes(labyrinth, most)
    return [(*size_of(labyrinth), labyrinth.start, bytes(route)) for route in routes]


def _compared(pair: disjointness.Pair, base: _Known, other: _Known) -> Pair:
    symmetric = counterparts(base.numbers, base.symmetric, other.numbers, other.symmetric)
    return Pair(
        **vars(pair),
        symmetric=dict(pair.mirrored) | symmetric,
        same_route=dict(_same_route(base, other)),
        nearest=dict(_nearest(base, other)),
    )


def _same_route(base: _Known, other: _Known) -> Iterator[tuple[str, str]]:
    owner: dict[Route, int] = {}
    for place, routes in enumerate(base.routes):
        for route in routes:
            owner.setdefault(route, place)
    for number, routes in zip(other.ids, other.routes, strict=True):
        if places := [owner[route] for route in routes if route in owner]:
            yield number, base.ids[min(places)]


def _nearest(base: _Known, other: _Known) -> Iterator[tuple[str, tuple[str, int]]]:
    for size, (places, table) in other.of_size.items():
        if size in base.of_size:
            held, among = base.of_size[size]
            near = nearest(table, among)
            pairs = zip(places, near.which.tolist(), near.walls.tolist(), strict=True)
            for place, index, walls in pairs:
                if walls != FAR:
                    yield other.ids[place], (base.ids[held[index]], walls)

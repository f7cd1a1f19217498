"""Leakage: what labyrinths of two splits have in common beyond an equal structure.

Every result is exact. Rotations, reflections and shared routes are found by looking up keys that
matching labyrinths share, so the time grows with the number of labyrinths, not of pairs.
`certificate` computes the keys of structures; `near_twins` finds structures a few walls apart.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import inf
from statistics import median
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.world.labyrinth import Labyrinth
from labyrinth_core.world.solver import shortest_routes
from pipeline.inspection.certificate import (
    Certificate,
    Found,
    Hashes,
    Held,
    Keys,
    Pair,
    canonical_hashes,
    certify,
    counterparts,
    digits,
    ids_of,
    places_by_size,
    size_of,
    structure_of,
)
from pipeline.inspection.near_twins import FAR, JOINED_WALLS, nearest, passage_table

NEAR = range(1, JOINED_WALLS + 1)
"""The distances in walls within which near twins are counted."""

ROUTES = 1_000
"""The maximum number of optimal routes compared per labyrinth."""

OptimalRoute = tuple[int, int, int, bytes]
"""Height and width of the labyrinth, the start, and the actions."""


@dataclass(frozen=True)
class Closeness:
    """How close the labyrinths of the second split of a pair are to those of the first."""

    pair: Pair
    """The two splits, and the structures they share."""
    symmetric: Found
    """Labyrinths whose structure is in the first split, up to rotation or reflection."""
    same_route: Found
    """Labyrinths with an optimal route that is also optimal in a labyrinth of the first split."""
    nearest: Mapping[str, tuple[str, int]]
    """Id -> id of the labyrinth with the nearest structure of its size, and the distance in walls.

    A labyrinth is missing if the first split has none of its size, or if none is near and there
    are too many pairs to compare (`near_twins.MOST_PAIRS`).
    """

    def within(self, walls: int) -> int:
        """Return how many labyrinths are at most `walls` walls from one of the first split."""
        return sum(apart <= walls for _, apart in self.nearest.values())

    def spread(self, of: int) -> str:
        """Return the minimum and the median distance to the nearest structure, in walls, as text.

        Args:
            of: The number of labyrinths of the second split; those not in `nearest` count as far.
        """
        walls = [apart for _, apart in self.nearest.values()]
        values = (min(walls, default=inf), median([*walls, *[inf] * (of - len(walls))]))
        return ", ".join("far" if value == inf else f"{value:g}" for value in values)


@dataclass(frozen=True)
class Leakage:
    """What the splits of a dataset have in common, and how close they are to each other."""

    certificate: Certificate
    pairs: Sequence[Closeness]
    """One for each pair of the certificate."""
    cut: int
    """The number of labyrinths of which only the first `ROUTES` optimal routes were compared."""

    def to_json(self) -> dict[str, Any]:
        """Return the leakage as plain types for JSON, with the counts of each pair."""
        pairs = []
        for each in self.pairs:
            values = dict(vars(each))
            values = vars(values.pop("pair")) | values
            within = {str(walls): each.within(walls) for walls in NEAR}
            spread = each.spread(self.certificate.labyrinths[each.pair.second])
            pairs.append(values | {"within": within, "spread": spread})
        return vars(self.certificate) | {"pairs": pairs, "cut": self.cut}


def find_leakage(
    splits: Mapping[str, Iterable[Held]],
    certificate: Certificate | None = None,
) -> Leakage:
    """Return the leakage between the splits of a dataset.

    Args:
        splits: The labyrinths of each split, or only their structures, which have no routes;
            `certify` explains what the names mean.
        certificate: The certificate of the splits; computed if None.
    """
    held = {split: list(dict.fromkeys(labyrinths)) for split, labyrinths in splits.items()}
    if certificate is None:
        certificate = certify({split: Keys.of(labyrinths) for split, labyrinths in held.items()})
    known = {
        split: _known(labyrinths)
        for split, labyrinths in held.items()
        if split not in certificate.strangers
    }
    pairs = [_closeness(pair, known[pair.first], known[pair.second]) for pair in certificate.pairs]
    return Leakage(certificate, pairs, sum(each.cut for each in known.values()))


class _Known(NamedTuple):
    """The keys by which counterparts of a split's labyrinths are found."""

    numbers: Hashes
    """The ids of the labyrinths."""
    symmetric: Hashes
    routes: list[list[OptimalRoute]]
    cut: int
    of_size: dict[tuple[int, int], tuple[list[int], NDArray[np.bool_]]]
    """Height and width -> indices of the labyrinths of that size, and their passages."""


def _known(labyrinths: list[Held]) -> _Known:
    found = [_optimal(each) for each in labyrinths]
    of_size = {
        size: (places, passage_table([structure_of(labyrinths[place]) for place in places]))
        for size, places in places_by_size(labyrinths).items()
    }
    return _Known(
        ids_of(labyrinths),
        canonical_hashes(labyrinths, with_ends=False),
        [routes[:ROUTES] for routes in found],
        sum(len(routes) > ROUTES for routes in found),
        of_size,
    )


def _optimal(labyrinth: Held) -> list[OptimalRoute]:
    """Return at most `ROUTES` + 1 optimal routes of a labyrinth; none for a structure."""
    if not isinstance(labyrinth, Labyrinth):
        return []
    routes = shortest_routes(labyrinth, ROUTES + 1)
    return [(*size_of(labyrinth), labyrinth.start, bytes(route)) for route in routes]


def _closeness(pair: Pair, base: _Known, other: _Known) -> Closeness:
    symmetric = counterparts(base.numbers, base.symmetric, other.numbers, other.symmetric)
    return Closeness(
        pair,
        symmetric=dict(pair.mirrored) | symmetric,
        same_route=dict(_same_route(base, other)),
        nearest=dict(_nearest(base, other)),
    )


def _same_route(base: _Known, other: _Known) -> Iterator[tuple[str, str]]:
    owner: dict[OptimalRoute, int] = {}
    for place, routes in enumerate(base.routes):
        for route in routes:
            owner.setdefault(route, place)
    for number, routes in zip(other.numbers, other.routes, strict=True):
        if places := [owner[route] for route in routes if route in owner]:
            yield digits(number), digits(base.numbers[min(places)])


def _nearest(base: _Known, other: _Known) -> Iterator[tuple[str, tuple[str, int]]]:
    for size, (places, table) in other.of_size.items():
        if size in base.of_size:
            held, among = base.of_size[size]
            near = nearest(table, among)
            pairs = zip(places, near.which.tolist(), near.walls.tolist(), strict=True)
            for place, index, walls in pairs:
                if walls != FAR:
                    twin = digits(base.numbers[held[index]])
                    yield digits(other.numbers[place]), (twin, walls)

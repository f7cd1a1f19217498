"""Leakage: what the labyrinths of two splits have in common beside their structures, exactly.

Everything is found by looking up keys that are equal where two labyrinths have something in common,
so that the time grows with the number of labyrinths and not of pairs. `near_twins` finds structures
a few walls apart, `certificate` those that a rotation or reflection makes the same.
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
"""The numbers of walls that near twins are counted by."""

ROUTES = 1_000
"""The largest number of optimal routes of a labyrinth that are compared."""

OptimalRoute = tuple[int, int, int, bytes]
"""Height and width of the labyrinth, the start, and the actions."""


@dataclass(frozen=True)
class Closeness:
    """How close the labyrinths of a split are to those of another."""

    pair: Pair
    """The two splits, and the structures that they share."""
    symmetric: Found
    """The shared ones, and those whose structures a rotation or reflection makes the same."""
    same_route: Found
    """Labyrinths with an optimal route that is optimal in a labyrinth of the first split, too."""
    nearest: Mapping[str, tuple[str, int]]
    """Id -> id of the labyrinth with the nearest structure of its size, and the walls between.

    A labyrinth is missing if the first split has none of its size, or none near among too many to
    compare (`near_twins.MOST_PAIRS`).
    """

    def within(self, walls: int) -> int:
        """Return the number of labyrinths at most so many walls from one of the first split."""
        return sum(apart <= walls for _, apart in self.nearest.values())

    def spread(self, of: int) -> str:
        """Return the distance to the nearest structure in walls, least and median.

        Args:
            of: The number of labyrinths of the second split; the missing ones count as far away.
        """
        walls = [apart for _, apart in self.nearest.values()]
        values = (min(walls, default=inf), median([*walls, *[inf] * (of - len(walls))]))
        return ", ".join("far" if value == inf else f"{value:g}" for value in values)


@dataclass(frozen=True)
class Leakage:
    """What the splits of a dataset have in common, and how close they are to one another."""

    certificate: Certificate
    pairs: Sequence[Closeness]
    """One for each pair of the certificate."""
    cut: int
    """The number of labyrinths with more than `ROUTES` optimal routes, of which only that many were
    compared."""

    def to_json(self) -> dict[str, Any]:
        """Return it in plain types, with the counts."""
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
    """Return what the splits of a dataset have in common.

    Args:
        splits: The labyrinths of each split, or structures alone, which have no routes; for the
            meaning of the names see `certify`.
        certificate: The certificate of the splits, if it is known.
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
    """The labyrinths of a split with the keys by which counterparts are found."""

    numbers: Hashes
    """Their ids."""
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
    """Return the optimal routes of a labyrinth, `ROUTES` + 1 at most; a structure has none."""
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

"""Leakage: what labyrinths of two splits have in common.

The certificate of disjointness compares structures. It takes 63-bit hashes, three per labyrinth:
two different labyrinths have the same hash with a probability of 2 ** -63. `find_leakage` also
compares routes, and finds near twins.

Every result is exact. What matches is found by looking up keys that matching labyrinths share, so
the time grows with the number of labyrinths, not of pairs.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from math import inf
from statistics import median
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from rich.box import SIMPLE_HEAD
from rich.table import Column, Table

from labyrinth_core.data import SPLITS
from labyrinth_core.language import labyrinth_id
from labyrinth_core.world import Labyrinth, Solver, Structure, identity
from pipeline.inspection.near_twins import (
    FAR,
    JOINED_WALLS,
    canonical_keys,
    nearest,
    passage_table,
)
from pipeline.machinery import count

NEAR = range(1, JOINED_WALLS + 1)
"""The distances in walls within which near twins are counted."""

LEAKS_SHOWN = 10
"""The maximum number of leaks of one kind printed in the terminal."""

ROUTES = 1_000
"""The maximum number of optimal routes compared per labyrinth."""

Hashes = NDArray[np.int64]
"""One hash of each labyrinth, shape (labyrinths,)."""

Held = Labyrinth | Structure
"""An item of a split: a labyrinth, or only its structure if start and goal are unknown."""

Found = Mapping[str, str]
"""Id of a labyrinth of the second split -> id of its first counterpart in the first split."""

OptimalRoute = tuple[int, int, int, bytes]
"""Height and width of the labyrinth, the start, and the actions."""


class Keys(NamedTuple):
    """The hashes by which the labyrinths of a split are compared, in the order of the split."""

    labyrinth: Hashes
    """The id of the labyrinth, as `labyrinth_id` gives it."""
    structure: Hashes
    """The id of its structure."""
    mirrored: Hashes
    """A hash that all rotations and reflections of structure, start and goal together share."""

    @classmethod
    def of(cls, labyrinths: Sequence[Held]) -> Keys:
        """Return the keys of labyrinths."""
        structures = [int(structure_of(each).structure_id, 16) for each in labyrinths]
        mirrored = _canonical_hashes(labyrinths, with_ends=True)
        return cls(_ids_of(labyrinths), np.array(structures, np.int64), mirrored)

    @classmethod
    def joined(cls, parts: Iterable[Keys]) -> Keys:
        """Return the keys of consecutive shards."""
        return cls(*map(np.concatenate, zip(*parts, strict=True)))


def structure_of(labyrinth: Held) -> Structure:
    """Return the structure of a labyrinth."""
    return labyrinth if isinstance(labyrinth, Structure) else labyrinth.structure


def id_of(labyrinth: Held) -> str:
    """Return the id of a labyrinth, or of a structure."""
    return labyrinth.structure_id if isinstance(labyrinth, Structure) else labyrinth_id(labyrinth)


def _ids_of(labyrinths: Sequence[Held]) -> Hashes:
    return np.array([int(id_of(each), 16) for each in labyrinths], np.int64)


def _places_by_size(labyrinths: Sequence[Held]) -> dict[tuple[int, int], list[int]]:
    """Return the indices of the labyrinths of each height and width."""
    places: dict[tuple[int, int], list[int]] = {}
    for number, structure in enumerate(map(structure_of, labyrinths)):
        places.setdefault((structure.height, structure.width), []).append(number)
    return places


def _canonical_hashes(labyrinths: Sequence[Held], *, with_ends: bool) -> Hashes:
    """Return a hash of each labyrinth that its rotations and reflections share.

    Args:
        labyrinths: Labyrinths of any sizes.
        with_ends: Whether start and goal must match, too. Ignored for a size of which some
            items are structures.
    """
    hashes = np.zeros(len(labyrinths), np.int64)
    for size, places in _places_by_size(labyrinths).items():
        held = [labyrinths[number] for number in places]
        ends = [(each.start, each.goal) for each in held if isinstance(each, Labyrinth)]
        marked = np.array(ends) if with_ends and len(ends) == len(held) else None
        keys = canonical_keys(*size, passage_table(list(map(structure_of, held))), marked)
        name = f"{min(size)}x{max(size)}"
        hashes[places] = [int(identity(f"{name}:{key.hex()}"), 16) for key in keys]
    return hashes


def _counterparts(
    first_ids: Hashes, first: Hashes, second_ids: Hashes, second: Hashes
) -> dict[str, str]:
    """Return the labyrinths of the second split whose hash occurs in the first split.

    Args:
        first_ids: The ids of the labyrinths of the first split.
        first: Their hashes.
        second_ids: The ids of the labyrinths of the second split.
        second: Their hashes.

    Returns:
        Id in the second split -> id of the first labyrinth of the first split with that hash.
    """
    known, places = np.unique(first, return_index=True)
    if not len(known):
        return {}
    at = np.minimum(np.searchsorted(known, second), len(known) - 1)
    equal = np.flatnonzero(known[at] == second)
    ids = zip(second_ids[equal], first_ids[places[at[equal]]], strict=True)
    return {_digits(number): _digits(other) for number, other in ids}


def _digits(number: np.int64) -> str:
    """Return an id as text: 16 hexadecimal digits."""
    return f"{number:016x}"


@dataclass(frozen=True)
class Pair:
    """The labyrinths of the second of two splits that are also in the first."""

    first: str
    second: str
    equal: Found
    """Labyrinths with the same structure."""
    mirrored: Found
    """`equal`, and labyrinths equal after a rotation or reflection, with start and goal."""


@dataclass(frozen=True)
class Certificate:
    """Which structures the splits of a dataset share or repeat."""

    labyrinths: Mapping[str, int]
    """Split -> number of different labyrinths in it."""
    repeated: Mapping[str, int]
    """Split -> number of labyrinths whose structure occurs earlier in the same split."""
    pairs: Sequence[Pair]
    """All pairs of splits with structures of their own.

    A shift is compared only with train, and with validation, on which a model is selected.
    """
    strangers: Mapping[str, Sequence[str]]
    """Split made from its parent's structures -> ids of its labyrinths with other structures."""

    def problems(self) -> Iterator[str]:
        """Yield a line for each pair of splits, and each split, that breaks the guarantee."""
        for pair in self.pairs:
            if pair.mirrored:
                yield (
                    f"{pair.first} and {pair.second} share {count(len(pair.equal), 'structure')}, "
                    f"{len(pair.mirrored)} counting mirror images"
                )
        yield from self.problems_of_splits()

    def problems_of_splits(self) -> Iterator[str]:
        """Yield a line for each split that repeats structures or has some that its parent lacks."""
        for split, copies in self.repeated.items():
            made_from_others = split in SPLITS.shifts and SPLITS[split].parent is not None
            if copies and split not in self.strangers and not made_from_others:
                yield f"{split} repeats {count(copies, 'structure')}"
        for split, ids in self.strangers.items():
            if ids:
                others = count(len(ids), "structure")
                yield f"{split} has {others} not found in {SPLITS[split].parent}"


def certify(splits: Mapping[str, Keys]) -> Certificate:
    """Return the certificate of a dataset.

    Args:
        splits: The keys of each split. A split named as in `SPLITS` is assumed to reuse the
            structures of its parent, if the parent is among the splits; all other splits are
            compared with each other.
    """
    names = dict.fromkeys([*(split for split in SPLITS if split in splits), *splits])
    strangers = {}
    for split in names:
        parent = _parent(split)
        if parent != split and parent in splits and len(splits[parent].structure):
            strange = ~np.isin(splits[split].structure, splits[parent].structure)
            ids = splits[split].labyrinth[strange]
            strangers[split] = list(dict.fromkeys(map(_digits, ids)))
    own = [name for name in names if name not in strangers]
    pairs = []
    for first, second in combinations(own, 2):
        if second not in SPLITS.shifts or first in SPLITS.sampled[:2]:
            base, other = splits[first], splits[second]
            of_base, of_other = base.labyrinth, other.labyrinth
            equal = _counterparts(of_base, base.structure, of_other, other.structure)
            mirrored = _counterparts(of_base, base.mirrored, of_other, other.mirrored)
            pairs.append(Pair(first, second, equal, equal | mirrored))
    return Certificate(
        labyrinths={split: len(np.unique(splits[split].labyrinth)) for split in names},
        repeated={
            split: len(splits[split].structure) - len(np.unique(splits[split].structure))
            for split in names
        },
        pairs=tuple(pairs),
        strangers=strangers,
    )


def _parent(split: str) -> str:
    """Return the split whose structures a split reuses, or the split itself."""
    kind = SPLITS.get(split)
    return split if kind is None or kind.new_structure else kind.parent or split


@dataclass(frozen=True)
class Closeness:
    """How close the labyrinths of the second split of a pair are to those of the first."""

    pair: Pair
    """The two splits, and the structures they share."""
    symmetric: Found
    """Labyrinths whose structure is in the first split, up to rotation or reflection."""
    same_route: Found
    """Labyrinths with an optimal route that is also optimal in a labyrinth of the first split,
    demonstrated or not. A known route of `evaluate` is a part of a demonstrated one."""
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

    def table(self, *, with_routes: bool) -> Table:
        """Return a table of the counts of each pair of splits, for the terminal."""
        walls = [f"{walls}\nwall{'s' * (walls > 1)}" for walls in NEAR]
        headings = ("of", "equal", "mirrored", "turned", *walls, "same\nroute", "nearest")
        table = Table(
            "splits",
            *(Column(heading, justify="right") for heading in headings),
            title="leakage: labyrinths of the second split with a counterpart in the first",
            caption="nearest: walls to the nearest structure of the first, minimum and median",
            box=SIMPLE_HEAD,
            padding=0,
        )
        for each in self.pairs:
            pair, of = each.pair, self.certificate.labyrinths[each.pair.second]
            counts = [of, len(pair.equal), len(pair.mirrored), len(each.symmetric)]
            counts += [each.within(walls) for walls in NEAR]
            table.add_row(
                f"{pair.first}, {pair.second}",
                *(f"{count:,}" for count in counts),
                f"{len(each.same_route):,}" if with_routes else "-",
                each.spread(of),
            )
        return table

    def lines(self, files: Mapping[str, Mapping[str, str]]) -> Iterator[str]:
        """Yield a line for each leak, at most `LEAKS_SHOWN` of a kind."""
        problems = [*self._shared(files), *self.certificate.problems_of_splits()]
        if problems:
            yield "Leakage:"
            yield from problems
        else:
            by_first: dict[str, list[str]] = {}
            for each in self.pairs:
                if each.symmetric:
                    counts = by_first.setdefault(each.pair.first, [])
                    counts.append(f"{len(each.symmetric):,} of {each.pair.second}")
            turned = "; ".join(f"{' and '.join(of)} in {first}" for first, of in by_first.items())
            yield "Leakage: no structure is in two splits, and none is repeated."
            yield "Mirrored with start and goal kept: none." + (
                f"\nTurned: {turned}." if by_first else " Turned: none."
            )
        if self.cut:
            yield f"{self.cut:,} labyrinths have too many optimal routes to compare all of them"

    def _shared(self, files: Mapping[str, Mapping[str, str]]) -> Iterator[str]:
        def named(split: str, number: str) -> str:
            return files[split][number] if files else f"{split} {number}"

        for pair in self.certificate.pairs:
            mirrored = {key: pair.mirrored[key] for key in pair.mirrored if key not in pair.equal}
            for shared, relation in ((pair.equal, "the structure"), (mirrored, "a mirror image")):
                for number, other in list(shared.items())[:LEAKS_SHOWN]:
                    twin = named(pair.first, other)
                    yield f"{named(pair.second, number)} has {relation} of {twin}"
                if len(shared) > LEAKS_SHOWN:
                    yield f"and {len(shared) - LEAKS_SHOWN:,} more of {pair.second}"


def find_leakage(
    splits: Mapping[str, Sequence[Held]],
    certificate: Certificate | None = None,
) -> Leakage:
    """Return the leakage between the splits of a dataset.

    Args:
        splits: The labyrinths of each split, or only their structures, which have no routes;
            `certify` explains what the names mean.
        certificate: The certificate of the splits; computed if None.
    """
    if certificate is None:
        certificate = certify({split: Keys.of(labyrinths) for split, labyrinths in splits.items()})
    held = {split: list(dict.fromkeys(labyrinths)) for split, labyrinths in splits.items()}
    known = {
        split: _known(labyrinths)
        for split, labyrinths in held.items()
        if split not in certificate.strangers
    }
    pairs = []
    for pair in certificate.pairs:
        base, other = known[pair.first], known[pair.second]
        symmetric = _counterparts(base.numbers, base.symmetric, other.numbers, other.symmetric)
        pairs.append(
            Closeness(
                pair,
                symmetric=dict(pair.mirrored) | symmetric,
                same_route=dict(_same_route(base, other)),
                nearest=dict(_nearest(base, other)),
            )
        )
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
    optimal = [_optimal(each) for each in labyrinths]
    of_size = {
        size: (places, passage_table([structure_of(labyrinths[number]) for number in places]))
        for size, places in _places_by_size(labyrinths).items()
    }
    return _Known(
        _ids_of(labyrinths),
        _canonical_hashes(labyrinths, with_ends=False),
        [routes[:ROUTES] for routes in optimal],
        sum(len(routes) > ROUTES for routes in optimal),
        of_size,
    )


def _optimal(labyrinth: Held) -> list[OptimalRoute]:
    """Return at most `ROUTES` + 1 optimal routes of a labyrinth; none for a structure."""
    if not isinstance(labyrinth, Labyrinth):
        return []
    beginning = labyrinth.structure.height, labyrinth.structure.width, labyrinth.start
    return [(*beginning, bytes(route)) for route in Solver(labyrinth).shortest_routes(ROUTES + 1)]


def _same_route(base: _Known, other: _Known) -> Iterator[tuple[str, str]]:
    owner: dict[OptimalRoute, int] = {}
    for place, routes in enumerate(base.routes):
        for route in routes:
            owner.setdefault(route, place)
    for number, routes in zip(other.numbers, other.routes, strict=True):
        if places := [owner[route] for route in routes if route in owner]:
            yield _digits(number), _digits(base.numbers[min(places)])


def _nearest(base: _Known, other: _Known) -> Iterator[tuple[str, tuple[str, int]]]:
    for size, (places, table) in other.of_size.items():
        if size in base.of_size:
            held, among = base.of_size[size]
            near = nearest(table, among)
            pairs = zip(places, near.which.tolist(), near.walls.tolist(), strict=True)
            for number, index, walls in pairs:
                if walls != FAR:
                    twin = _digits(base.numbers[held[index]])
                    yield _digits(other.numbers[number]), (twin, walls)

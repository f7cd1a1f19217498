"""The certificate of disjointness: which labyrinths two splits share, counted and not assumed.

Labyrinths are compared by hashes of 63 bits; two that differ have the same with a probability of
2 ** -63. So three numbers of each labyrinth are all that has to be in memory.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.data.columns import SAMPLED_SPLITS, SPLITS
from labyrinth_core.language.text import labyrinth_id
from labyrinth_core.world.labyrinth import Labyrinth, identity
from labyrinth_core.world.near_twins import passage_table
from labyrinth_core.world.symmetry import canonical_keys

Hashes = NDArray[np.int64]
"""One hash of each labyrinth, shape (labyrinths,)."""

Found = Mapping[str, str]
"""Id of a labyrinth of the second split -> id of its first counterpart in the first split."""


class Keys(NamedTuple):
    """The hashes by which the labyrinths of a split are compared, in the order of the split."""

    labyrinth: Hashes
    """The id of the labyrinth, as `labyrinth_id` gives it."""
    structure: Hashes
    """The id of its structure."""
    mirrored: Hashes
    """The same for all images under rotations and reflections of structure, start and goal."""

    @classmethod
    def of(cls, labyrinths: Sequence[Labyrinth]) -> Keys:
        """Return the keys of labyrinths."""
        structures = [int(each.structure.structure_id, 16) for each in labyrinths]
        mirrored = canonical_hashes(labyrinths, with_ends=True)
        return cls(ids_of(labyrinths), np.array(structures, np.int64), mirrored)

    @classmethod
    def joined(cls, parts: Iterable[Keys]) -> Keys:
        """Return the keys of shards that follow one another."""
        return cls(*map(np.concatenate, zip(*parts, strict=True)))


def ids_of(labyrinths: Sequence[Labyrinth]) -> Hashes:
    """Return the ids of labyrinths as numbers."""
    return np.array([int(labyrinth_id(each), 16) for each in labyrinths], np.int64)


def size_of(labyrinth: Labyrinth) -> tuple[int, int]:
    """Return the height and the width of a labyrinth."""
    return labyrinth.structure.height, labyrinth.structure.width


def places_by_size(labyrinths: Sequence[Labyrinth]) -> dict[tuple[int, int], list[int]]:
    """Return the indices of the labyrinths of each size."""
    places: dict[tuple[int, int], list[int]] = {}
    for place, labyrinth in enumerate(labyrinths):
        places.setdefault(size_of(labyrinth), []).append(place)
    return places


def canonical_hashes(labyrinths: Sequence[Labyrinth], *, with_ends: bool) -> Hashes:
    """Return a hash of each labyrinth that its rotations and reflections share.

    Args:
        labyrinths: Labyrinths of any sizes.
        with_ends: Whether start and goal have to be mapped on one another, too.
    """
    hashes = np.zeros(len(labyrinths), np.int64)
    for size, places in places_by_size(labyrinths).items():
        held = [labyrinths[place] for place in places]
        ends = np.array([(each.start, each.goal) for each in held]) if with_ends else None
        keys = canonical_keys(*size, passage_table([each.structure for each in held]), ends)
        hashes[places] = [
            int(identity(f"{height}x{width}:{key.hex()}"), 16) for height, width, key in keys
        ]
    return hashes


def counterparts(
    first_ids: Hashes, first: Hashes, second_ids: Hashes, second: Hashes
) -> dict[str, str]:
    """Return which labyrinths of the second split have a hash that one of the first split has.

    The arguments are the ids of the labyrinths of each split, and their hashes.

    Returns:
        Id of each of them -> id of the first labyrinth of the first split with that hash.
    """
    known, places = np.unique(first, return_index=True)
    if not len(known):
        return {}
    at = np.minimum(np.searchsorted(known, second), len(known) - 1)
    found = np.flatnonzero(known[at] == second)
    ids = zip(second_ids[found], first_ids[places[at[found]]], strict=True)
    return {_digits(number): _digits(other) for number, other in ids}


def _digits(number: np.int64) -> str:
    return f"{number:016x}"


@dataclass(frozen=True)
class Pair:
    """What the labyrinths of a split have in common with those of another."""

    first: str
    second: str
    equal: Found
    """Labyrinths with the same structure."""
    mirrored: Found
    """These, and those that a rotation or reflection makes the same, with their start and goal."""


@dataclass(frozen=True)
class Certificate:
    """What the splits of a dataset have in common."""

    labyrinths: Mapping[str, int]
    """Split -> number of different labyrinths in it."""
    repeated: Mapping[str, int]
    """Split -> number of labyrinths whose structure came before in the same split."""
    pairs: Sequence[Pair]
    """All pairs of the splits with structures of their own."""
    strangers: Mapping[str, Sequence[str]]
    """Split made of the structures of train -> ids of the labyrinths in it with another one."""

    def problems(self) -> Iterator[str]:
        """Yield a line for everything that breaks the guarantee."""
        for pair in self.pairs:
            if pair.mirrored:
                yield (
                    f"{pair.first} and {pair.second} share {len(pair.equal)} structures, "
                    f"{len(pair.mirrored)} when mirror images count"
                )
        for split, count in self.repeated.items():
            if count and split not in self.strangers:
                yield f"{split} repeats {count} structures"
        for split, ids in self.strangers.items():
            if ids:
                yield f"{split} has {len(ids)} structures that are not in train"


def certify(splits: Mapping[str, Keys]) -> Certificate:
    """Return the certificate of a dataset.

    Args:
        splits: The keys of each split. Where there is a train, splits called random, s0 and
            s0_and_g are taken to be made of its structures; all others are compared with one
            another.
    """
    names = dict.fromkeys([*(split for split in SPLITS if split in splits), *splits])
    train = splits["train"].structure if "train" in splits else np.zeros(0, np.int64)
    derived = [split for split in SPLITS if split in names and split not in SAMPLED_SPLITS]
    strangers = {}
    for split in derived if len(train) else ():
        strange = splits[split].labyrinth[~np.isin(splits[split].structure, train)]
        strangers[split] = list(dict.fromkeys(map(_digits, strange)))
    return Certificate(
        labyrinths={split: len(np.unique(splits[split].labyrinth)) for split in names},
        repeated={
            split: len(splits[split].structure) - len(np.unique(splits[split].structure))
            for split in names
        },
        pairs=tuple(
            _compared(first, splits[first], second, splits[second])
            for first, second in combinations([n for n in names if n not in strangers], 2)
        ),
        strangers=strangers,
    )


def _compared(first: str, base: Keys, second: str, other: Keys) -> Pair:
    equal = counterparts(base.labyrinth, base.structure, other.labyrinth, other.structure)
    mirrored = counterparts(base.labyrinth, base.mirrored, other.labyrinth, other.mirrored)
    return Pair(first, second, equal, equal | mirrored)

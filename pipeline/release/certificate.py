"""The certificate of uniqueness: which structures two splits share, counted and not assumed."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import combinations
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.grid import neighbours
from labyrinth_core.labyrinth import Structure
from pipeline.schema import SAMPLED_SPLITS

PROBES = 200
"""Structures of validation and of test, at most, whose near twins in train are looked for."""


@dataclass(frozen=True, eq=False)
class Structures:
    """The structures of one split, as far as comparing them needs."""

    ids: NDArray[np.int64]
    """The `structure_id` of each labyrinth, in order, shape (labyrinths,)."""
    canonical_ids: NDArray[np.int64]
    """That of its canonical form, which its mirror image shares, shape (labyrinths,)."""
    probes: tuple[Structure, ...]
    """The first of them, `PROBES` at most."""


class Overlap(NamedTuple):
    """What two of train, validation and test share."""

    first: str
    second: str
    structures: int
    """Structures that are in both."""
    canonical: int
    """Structures that are in both, or whose mirror image that keeps start and goal is."""


class NearTwins(NamedTuple):
    """How many structures of a split are one wall away from one of train, or its mirror image."""

    split: str
    probed: int
    found: int


@dataclass(frozen=True)
class Certificate:
    """What the splits of one dataset share."""

    overlaps: tuple[Overlap, ...]
    repeated: Mapping[str, int]
    """Split -> labyrinths whose structure came before in the same split."""
    strangers: Mapping[str, int]
    """Split made of train's structures -> labyrinths whose structure is not one of them."""
    near_twins: tuple[NearTwins, ...]

    def problems(self) -> Iterator[str]:
        """Yield what breaks the guarantee, a line for each."""
        for first, second, structures, canonical in self.overlaps:
            if structures or canonical:
                yield (
                    f"{first} and {second} share {structures} structures, "
                    f"{canonical} when mirror images count"
                )
        for split, count in self.repeated.items():
            if count:
                yield f"{split} repeats {count} structures"
        for split, count in self.strangers.items():
            if count:
                yield f"{split} has {count} structures that are not in train"


def certify(structures: Mapping[str, Structures]) -> Certificate:
    """Return the certificate of a dataset.

    Structures are compared by their ids of 63 bits; two that differ share one with a probability
    of 2 ** -63.

    Args:
        structures: By split, of all splits.
    """
    unique = {split: np.unique(held.ids) for split, held in structures.items()}
    canonical = {split: np.unique(held.canonical_ids) for split, held in structures.items()}
    derived = [split for split in structures if split not in SAMPLED_SPLITS]
    return Certificate(
        overlaps=tuple(
            Overlap(
                first,
                second,
                _shared(unique[first], unique[second]),
                _shared(canonical[first], canonical[second]),
            )
            for first, second in combinations(SAMPLED_SPLITS, 2)
        ),
        repeated={s: len(structures[s].ids) - len(unique[s]) for s in SAMPLED_SPLITS},
        strangers={
            split: int((~np.isin(structures[split].ids, unique["train"])).sum())
            for split in derived
        },
        near_twins=tuple(
            _near_twins(split, structures[split].probes, canonical["train"])
            for split in SAMPLED_SPLITS[1:]
        ),
    )


def _shared(first: NDArray[np.int64], second: NDArray[np.int64]) -> int:
    return len(np.intersect1d(first, second, assume_unique=True))


def _near_twins(split: str, probes: tuple[Structure, ...], train: NDArray[np.int64]) -> NearTwins:
    found = 0
    for structure in probes:
        ids = [int(twin.canonical().structure_id, 16) for twin in _one_wall_away(structure)]
        found += bool(np.isin(np.array(ids, np.int64), train).any())
    return NearTwins(split, len(probes), found)


def _one_wall_away(structure: Structure) -> Iterator[Structure]:
    """Yield the structures with one wall more or less, connected or not."""
    height, width = structure.height, structure.width
    for cell in range(structure.cells):
        for beside in neighbours(cell, height, width).values():
            if beside == cell + 1:
                yield Structure(height, width, structure.up, structure.right ^ 1 << cell)
            elif beside == cell + width:
                yield Structure(height, width, structure.up ^ 1 << cell, structure.right)

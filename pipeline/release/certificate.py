"""The certificate of uniqueness: which structures two splits share, counted and not assumed.

How near they are to one another is in the file that the stage `analyse` has left, if it has.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import combinations
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.data.columns import SAMPLED_SPLITS
from labyrinth_core.data.errors import DatasetError
from labyrinth_core.data.manifest import ANALYSIS, Manifest
from labyrinth_core.data.storage import AnyPath


@dataclass(frozen=True, eq=False)
class Structures:
    """The structures of one split, as far as comparing them needs."""

    ids: NDArray[np.int64]
    """The `structure_id` of each labyrinth, in order, shape (labyrinths,)."""
    canonical_ids: NDArray[np.int64]
    """That of its canonical form, which its mirror image shares, shape (labyrinths,)."""


class Overlap(NamedTuple):
    """What two of train, validation and test share."""

    first: str
    second: str
    structures: int
    """Structures that are in both."""
    canonical: int
    """Structures that are in both, or whose mirror image that keeps start and goal is."""


class Closeness(NamedTuple):
    """How many structures of a split have what counterpart in another."""

    first: str
    second: str
    of: int
    """Labyrinths of the second split."""
    symmetric: int
    """A rotation or reflection of them is in the first."""
    within: tuple[int, ...]
    """At most 1, 2 and 3 walls away is one in the first."""
    same_route: int
    """An optimal route of them is optimal in a labyrinth of the first."""
    nearest: str
    """Walls to the nearest in the first, least and median."""


@dataclass(frozen=True)
class Certificate:
    """What the splits of one dataset share."""

    overlaps: tuple[Overlap, ...]
    repeated: Mapping[str, int]
    """Split -> labyrinths whose structure came before in the same split."""
    strangers: Mapping[str, int]
    """Split made of train's structures -> labyrinths whose structure is not one of them."""

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
    )


def _shared(first: NDArray[np.int64], second: NDArray[np.int64]) -> int:
    return len(np.intersect1d(first, second, assume_unique=True))


def read_closeness(folder: AnyPath, manifest: Manifest) -> tuple[Closeness, ...]:
    """Return what the stage `analyse` has found out about a dataset, if it has.

    Args:
        folder: Of the dataset.
        manifest: Of that folder; what was found out about other rows is left alone.

    Raises:
        DatasetError: The file is none that it writes.
    """
    path = folder / ANALYSIS
    try:
        content = json.loads(path.read_bytes())
        if content["fingerprint"] != manifest.fingerprint:
            return ()
        leakage = content["leakage"]
        return tuple(
            Closeness(
                str(pair["first"]),
                str(pair["second"]),
                int(leakage["labyrinths"][pair["second"]]),
                len(pair["symmetric"]),
                tuple(int(pair["within"][walls]) for walls in ("1", "2", "3")),
                len(pair["same_route"]),
                str(pair["spread"]),
            )
            for pair in leakage["pairs"]
        )
    except FileNotFoundError:
        return ()
    except (ValueError, LookupError, TypeError, AttributeError) as error:
        raise DatasetError(f"{path} cannot be read: stages=[analyse] writes it anew") from error

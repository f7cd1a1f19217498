"""The certificate of disjointness: which labyrinths two splits share, by comparing all of them.

Labyrinths are compared by 63-bit hashes: two different labyrinths have the same hash with a
probability of 2 ** -63. So memory only has to hold three numbers per labyrinth.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.data.splits import SAMPLED_SPLITS, SHIFTS, SPLITS
from labyrinth_core.language.text import labyrinth_id
from labyrinth_core.world.labyrinth import Labyrinth, Structure, identity
from pipeline.inspection.near_twins import passage_table
from pipeline.machinery.markdown import count

Hashes = NDArray[np.int64]
"""One hash of each labyrinth, shape (labyrinths,)."""

Held = Labyrinth | Structure
"""An item of a split: a labyrinth, or only its structure if start and goal are unknown."""

Planes = tuple[NDArray[np.bool_], NDArray[np.bool_], NDArray[np.bool_]]
"""Passages up (n, height - 1, width) and right (n, height, width - 1), marks (n, m, height, width).

Axes of the grid: row 0 at the bottom, column 0 at the left.
"""

Found = Mapping[str, str]
"""Id of a labyrinth of the second split -> id of its first counterpart in the first split."""


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
        mirrored = canonical_hashes(labyrinths, with_ends=True)
        return cls(ids_of(labyrinths), np.array(structures, np.int64), mirrored)

    @classmethod
    def joined(cls, parts: Iterable[Keys]) -> Keys:
        """Return the keys of consecutive shards."""
        return cls(*map(np.concatenate, zip(*parts, strict=True)))


def structure_of(labyrinth: Held) -> Structure:
    """Return the structure of a labyrinth."""
    return labyrinth if isinstance(labyrinth, Structure) else labyrinth.structure


def ids_of(labyrinths: Sequence[Held]) -> Hashes:
    """Return the ids of labyrinths, or of structures, as numbers."""
    ids = (
        each.structure_id if isinstance(each, Structure) else labyrinth_id(each)
        for each in labyrinths
    )
    return np.array([int(number, 16) for number in ids], np.int64)


def size_of(labyrinth: Held) -> tuple[int, int]:
    """Return the height and the width of a labyrinth."""
    structure = structure_of(labyrinth)
    return structure.height, structure.width


def places_by_size(labyrinths: Sequence[Held]) -> dict[tuple[int, int], list[int]]:
    """Return the indices of the labyrinths of each size."""
    places: dict[tuple[int, int], list[int]] = {}
    for place, labyrinth in enumerate(labyrinths):
        places.setdefault(size_of(labyrinth), []).append(place)
    return places


def canonical_hashes(labyrinths: Sequence[Held], *, with_ends: bool) -> Hashes:
    """Return a hash of each labyrinth that its rotations and reflections share.

    Args:
        labyrinths: Labyrinths of any sizes.
        with_ends: Whether start and goal must match, too. Ignored for a size of which some
            items are structures.
    """
    hashes = np.zeros(len(labyrinths), np.int64)
    for size, places in places_by_size(labyrinths).items():
        held = [labyrinths[place] for place in places]
        ends = [(each.start, each.goal) for each in held if isinstance(each, Labyrinth)]
        marked = np.array(ends) if with_ends and len(ends) == len(held) else None
        keys = _canonical_keys(*size, passage_table(list(map(structure_of, held))), marked)
        name = f"{min(size)}x{max(size)}"
        hashes[places] = [int(identity(f"{name}:{key.hex()}"), 16) for key in keys]
    return hashes


def _canonical_keys(
    height: int, width: int, passages: NDArray[np.bool_], cells: NDArray[np.int64] | None
) -> list[bytes]:
    """Return a key for each structure, the same for all its rotations and reflections.

    Args:
        height: Rows of all structures.
        width: Columns.
        passages: As `near_twins.passage_table` gives them, shape (n, passages).
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


def counterparts(
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
    found = np.flatnonzero(known[at] == second)
    ids = zip(second_ids[found], first_ids[places[at[found]]], strict=True)
    return {digits(number): digits(other) for number, other in ids}


def digits(number: np.int64) -> str:
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
            made_from_others = split in SHIFTS and SPLITS[split].parent is not None
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
            strangers[split] = list(dict.fromkeys(map(digits, ids)))
    own = [name for name in names if name not in strangers]
    return Certificate(
        labyrinths={split: len(np.unique(splits[split].labyrinth)) for split in names},
        repeated={
            split: len(splits[split].structure) - len(np.unique(splits[split].structure))
            for split in names
        },
        pairs=tuple(
            _compared(first, splits[first], second, splits[second])
            for first, second in combinations(own, 2)
            if second not in SHIFTS or first in SAMPLED_SPLITS[:2]
        ),
        strangers=strangers,
    )


def _parent(split: str) -> str:
    """Return the split whose structures a split reuses, or the split itself."""
    kind = SPLITS.get(split)
    return split if kind is None or kind.new_structure else kind.parent or split


def _compared(first: str, base: Keys, second: str, other: Keys) -> Pair:
    equal = counterparts(base.labyrinth, base.structure, other.labyrinth, other.structure)
    mirrored = counterparts(base.labyrinth, base.mirrored, other.labyrinth, other.mirrored)
    return Pair(first, second, equal, equal | mirrored)

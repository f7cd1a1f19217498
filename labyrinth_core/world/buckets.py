"""Which of train, validation and test a structure belongs to, by a hash of the structure."""

from __future__ import annotations

from collections.abc import Sequence

from labyrinth_core.world.structure import Structure

SPLITS = ("train", "validation", "test")
BUCKETS = (34, 33, 33)
"""The default percentages of all structures in these splits."""


def split_of(structure: Structure, buckets: Sequence[int]) -> str:
    """Return the split to which a structure belongs in every dataset: train, validation or test.

    Args:
        structure: The structure; its mirror image that keeps start and goal is in the same split.
        buckets: The percentages of all structures in the three splits.
    """
    percent = int(structure.canonical().structure_id, 16) * 100 >> 63
    train, validation, _ = buckets
    if percent < train:
        return "train"
    return "validation" if percent < train + validation else "test"


def bucket_at_any_ends(structure: Structure, buckets: Sequence[int]) -> str | None:
    """Return the split that may hold a structure with any start and goal; None if it is left out.

    Any rotation or reflection may then give the same labyrinth again. So a structure is allowed
    only if it is in the same split as the smallest of its eight images, a rule that depends on
    nothing else in the dataset.
    """
    split = split_of(structure, buckets)
    least = min(structure.symmetries())
    return split if split_of(least, buckets) == split else None

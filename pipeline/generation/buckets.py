"""The hash that decides which split a structure may be in, in every dataset."""

from __future__ import annotations

from collections.abc import Sequence

from labyrinth_core.world.labyrinth import Structure


def split_of(structure: Structure, buckets: Sequence[int]) -> str:
    """Return whether a structure belongs to train, validation or test.

    Args:
        structure: The structure; its mirror image that keeps start and goal gives the same answer.
        buckets: The percentage of all structures for each of the three.
    """
    percent = int(structure.canonical().structure_id, 16) * 100 >> 63
    train, validation, _ = buckets
    if percent < train:
        return "train"
    return "validation" if percent < train + validation else "test"

"""The hash that decides which split a structure may be in, in every dataset."""

from __future__ import annotations

from collections.abc import Sequence

from labyrinth_core.data.dataset_config import DatasetConfig
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


def bucket_of(config: DatasetConfig, structure: Structure) -> str | None:
    """Return which of train, validation and test a structure may be in, None if in none.

    It is what `split_of` says. Where start and goal vary, any rotation or reflection may be the
    same labyrinth again; so of the eight images of a structure those alone may be used that are in
    one bucket with the smallest of them. That depends on nothing else in the dataset.
    """
    split = split_of(structure, config.buckets)
    if config.goals == "fixed":
        return split
    images = [each for each in structure.symmetries() if each.height == structure.height]
    least = min(images, key=lambda image: (image.up, image.right))
    return split if split_of(least, config.buckets) == split else None

"""What follows from the id of a structure: its split, and all randomness in it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from labyrinth_core.data.dataset_config import DatasetConfig
from labyrinth_core.data.splits import SPLITS
from labyrinth_core.world.labyrinth import Structure

PLACING, ACTING = 0, 1
"""The purposes of the randomness of a structure."""

DRAWING = 2
"""The purpose of the randomness of a chunk of candidates."""


def split_of(structure: Structure, buckets: Sequence[int]) -> str:
    """Return whether a structure belongs to train, validation or test, in every dataset.

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

    With fixed goals that is `split_of`. Where start and goal vary, any rotation or reflection may
    be the same labyrinth again. Of the eight images of a structure only those may then be used that
    are in the same bucket as the smallest of them, which depends on nothing else in the dataset.
    """
    split = split_of(structure, config.buckets)
    if config.goals == "fixed":
        return split
    images = [each for each in structure.symmetries() if each.height == structure.height]
    least = min(images, key=lambda image: (image.up, image.right))
    return split if split_of(least, config.buckets) == split else None


def item_rng(
    config: DatasetConfig, split: str, structure: Structure, purpose: int = PLACING
) -> np.random.Generator:
    """Return a generator for one structure in one split, independent of all others.

    Args:
        config: The configuration of the dataset.
        split: A split of the dataset.
        structure: The structure.
        purpose: `PLACING` of start, goal and tiles, or `ACTING` in the labyrinth.
    """
    key = (SPLITS[split].number, int(structure.structure_id, 16), purpose)
    return np.random.default_rng(np.random.SeedSequence(config.seed, spawn_key=key))

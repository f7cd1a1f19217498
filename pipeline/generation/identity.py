"""What follows from the id of a structure: its split, and all randomness in it; and sets of ids."""

from __future__ import annotations

from array import array
from collections.abc import Sequence

import numpy as np

from labyrinth_core.data.dataset_config import DatasetConfig
from labyrinth_core.data.splits import SPLITS
from labyrinth_core.world.labyrinth import Structure

PLACING, ACTING = 0, 1
"""The purposes of the randomness of a structure."""

_EMPTY = -1


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


class IdSet:
    """A set of ids of structures as 63-bit numbers, 16 to 32 bytes for each.

    There may be millions, and a Python set takes about a hundred bytes for each. Slots are probed
    one after the other from where the low bits of the id point, and doubled when half are taken.
    """

    def __init__(self) -> None:
        self._slots = array("q", [_EMPTY]) * 1024
        self._count = 0

    def add(self, number: int) -> bool:
        """Add an id; return whether it is new."""
        slot = self._slot(number)
        if self._slots[slot] == number:
            return False
        self._slots[slot] = number
        self._count += 1
        if 2 * self._count > len(self._slots):
            self._grow()
        return True

    def _slot(self, number: int) -> int:
        """Return where an id is, or would be."""
        slots = self._slots
        last = len(slots) - 1
        slot = number & last
        while slots[slot] != _EMPTY and slots[slot] != number:
            slot = (slot + 1) & last
        return slot

    def _grow(self) -> None:
        numbers = self._slots
        self._slots = array("q", [_EMPTY]) * (2 * len(numbers))
        for number in numbers:
            if number != _EMPTY:
                self._slots[self._slot(number)] = number

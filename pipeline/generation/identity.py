"""The randomness of a structure in a split, which follows from its id."""

from __future__ import annotations

import numpy as np

from labyrinth_core.data.dataset_config import DatasetConfig
from labyrinth_core.data.splits import SPLITS
from labyrinth_core.world.labyrinth import Structure

PLACING, ACTING = 0, 1
"""The purposes of the randomness of a structure."""

DRAWING = 2
"""The purpose of the randomness of a chunk of candidates."""


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

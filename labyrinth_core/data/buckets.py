"""The part of all structures that may be in train, in validation and in test, in every dataset.

A hash of the structure decides, so that what a policy may have learnt from and what it is judged on
never coincide: within a dataset, across datasets of other seeds or lengths, or of rows and columns
exchanged (with the same `buckets`), and in labyrinths that are drawn without a dataset.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from labyrinth_core.data.dataset_config import DatasetConfig
from labyrinth_core.world.labyrinth import Labyrinth, LabyrinthError, Structure
from labyrinth_core.world.sampling import sample_structures
from labyrinth_core.world.tasks import MAX_DRAWS, default_start_and_goal, draw_start_and_goal, place


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
    least = min(structure.symmetries())
    return split if split_of(least, config.buckets) == split else None


def sample_test(config: DatasetConfig, rng: np.random.Generator) -> Iterator[Labyrinth]:
    """Yield random labyrinths from the distribution of a dataset's `test`, without end.

    Each is drawn independently of the others and of the dataset, so that a labyrinth of its `test`
    may be among them, and none of train or validation is. `splits.min_walls` is not observed.

    Raises:
        LabyrinthError: Of many structures in a row none can hold the task.
    """
    ends = default_start_and_goal(config.height, config.width)
    structures = sample_structures(
        config.height,
        config.width,
        rng,
        algorithm=config.sampler,
        open_walls=config.open_walls,
    )
    failed = 0
    for structure in structures:
        if failed == MAX_DRAWS:
            raise LabyrinthError(f"none of {failed:,} structures can hold task={config.task}")
        failed += 1
        if bucket_of(config, structure) == "test":
            try:
                if config.goals == "varied":
                    yield draw_start_and_goal(structure, config.task, rng)
                else:
                    yield place(structure, *ends, config.task, rng)
                failed = 0
            except LabyrinthError:
                continue

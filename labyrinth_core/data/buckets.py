"""Assign each structure to train, validation or test, alike in every dataset.

A hash of the structure decides. So training and test structures never overlap: within a dataset,
between datasets with other seeds or lengths or with rows and columns exchanged (if `buckets` are
the same), and in labyrinths that are sampled without a dataset.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from labyrinth_core.data.dataset_config import DatasetConfig
from labyrinth_core.world.buckets import bucket_at_any_ends, split_of
from labyrinth_core.world.labyrinth import Labyrinth, LabyrinthError
from labyrinth_core.world.sampling import sample_structures
from labyrinth_core.world.structure import Structure
from labyrinth_core.world.tasks import MAX_DRAWS, default_start_and_goal, draw_start_and_goal, place


def bucket_of(config: DatasetConfig, structure: Structure) -> str | None:
    """Return which of train, validation and test may hold a structure; None if it is left out."""
    if config.goals == "fixed":
        return split_of(structure, config.buckets)
    return bucket_at_any_ends(structure, config.buckets)


def sample_test(config: DatasetConfig, rng: np.random.Generator) -> Iterator[Labyrinth]:
    """Yield random labyrinths from the distribution of a dataset's `test`, without end.

    Each is drawn independently of the others and of the dataset: labyrinths of its `test` may
    occur, those of train and validation never do. `splits.min_walls` is not enforced.

    Raises:
        LabyrinthError: None of `MAX_DRAWS` structures in a row can hold the task.
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

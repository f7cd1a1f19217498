"""The splits of a dataset: the six that each has, and the shifts that it may have besides.

A shift changes one thing and holds the rest. Most are made labyrinth by labyrinth from another
split, their parent; those without a parent have structures of their own, which nothing is trained
on.
"""

from __future__ import annotations

from typing import NamedTuple

from labyrinth_core.world.labyrinth import Look
from labyrinth_core.world.sampling import ALGORITHMS


class Split(NamedTuple):
    """What a split holds."""

    meaning: str
    bucket: str
    """Where the hash of its structures puts them: train, validation or test."""
    parent: str | None = None
    """The split whose labyrinths its own are made from, one of each at most, in their order."""
    new_start: bool = False
    """Whether the start is another than its parent's."""
    new_goal: bool = False
    """Whether the goal is another than its parent's."""
    new_structure: bool = False
    """Whether the structure is another than its parent's."""
    look: Look = Look.PLAIN
    """How its pictures are drawn."""


SAMPLED_SPLITS = ("train", "validation", "test")
"""The splits that every dataset samples structures for."""

BASE_SPLITS = (*SAMPLED_SPLITS, "random", "s0", "s0_and_g")
"""The splits that every dataset has."""

SPLITS = {
    "train": Split("demonstrations to learn from", "train"),
    "validation": Split("other structures, to choose a model with", "validation"),
    "test": Split("other structures again, to judge it on", "test"),
    "random": Split("a uniformly random policy on the structures of train", "train", "train"),
    "s0": Split("the structures of train with another start", "train", "train", new_start=True),
    "s0_and_g": Split(
        "the structures of train with another start and another goal",
        "train",
        "train",
        new_start=True,
        new_goal=True,
    ),
    # The names' places in this table are part of the randomness, so new ones come last.
    "g": Split("the structures of train with another goal", "train", "train", new_goal=True),
    "test_s0": Split("the structures of test with another start", "test", "test", new_start=True),
    "test_g": Split("the structures of test with another goal", "test", "test", new_goal=True),
    "test_s0_and_g": Split(
        "the structures of test with another start and another goal",
        "test",
        "test",
        new_start=True,
        new_goal=True,
    ),
    "one_wall": Split(
        "labyrinths of train with one wall opened or shut, so that the demonstrated route is "
        "blocked or no longer shortest",
        "test",
        "train",
        new_structure=True,
    ),
    "longer": Split("routes longer than the longest of train, on other structures", "test"),
    "trees": Split("other structures, without loops", "test"),
    "open": Split("other structures, each with more loops than any of train", "test"),
    **{sampler: Split(f"other structures, sampled by {sampler}", "test") for sampler in ALGORITHMS},
    "recoloured": Split(
        "the labyrinths and routes of test in other colours", "test", "test", look=Look.RECOLOURED
    ),
    "thin_walls": Split(
        "the labyrinths and routes of test with thin walls", "test", "test", look=Look.THIN_WALLS
    ),
    "test_new_routes": Split(
        "other structures, none with an optimal route that train demonstrates", "test"
    ),
}
"""Split -> what it holds."""

SHIFTS = tuple(name for name in SPLITS if name not in BASE_SPLITS)
"""The splits that a dataset may have besides, in their order."""


def parent_split(split: str) -> str | None:
    """Return the split of the labyrinths that those of a split are made from, None if of none."""
    return SPLITS[split].parent


def is_of_train(split: str) -> bool:
    """Return whether a split holds the labyrinths of train, or one made from each, in order."""
    kind = SPLITS[split]
    return split == "train" or (kind.parent == "train" and not kind.new_structure)


def is_selected(split: str) -> bool:
    """Return whether a shift has structures of its own, which are selected for it."""
    return split in SHIFTS and SPLITS[split].parent is None

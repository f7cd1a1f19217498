"""The splits of a dataset: the six that every dataset has, and the shifts that it may add.

A shift changes one property and keeps the rest. Most are derived, labyrinth by labyrinth, from a
parent split. Shifts without a parent have structures of their own, which are never trained on;
`pipeline.generation.shifts` says how these are selected.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

from labyrinth_core.world import Look


class Refusal(NamedTuple):
    """An option of a dataset with which a shift makes no sense."""

    option: str
    """A field or property of `DatasetConfig`."""
    refuses: Callable[[Any], bool]
    """Returns whether the shift makes no sense with the given value."""
    reason: str


@dataclass(frozen=True)
class Split:
    """A kind of split. `new_start` to `look` say how its labyrinths differ from their parents."""

    number: int
    """The split's part of every random key: another number would change published bytes."""
    meaning: str
    bucket: str
    """The split that its structures' hashes select: train, validation or test. A shift may not have
    structures of train's bucket that its parent lacks, as other datasets train on them."""
    parent: str | None = None
    """The split it is derived from: at most one labyrinth for each parent, in the same order."""
    new_start: bool = False
    new_goal: bool = False
    new_structure: bool = False
    """Whether its structures are others, made as `pipeline.generation.labyrinths` says."""
    look: Look = Look.PLAIN
    refusals: tuple[Refusal, ...] = ()
    """The options with which a dataset cannot have this shift."""

    @property
    def is_redrawn(self) -> bool:
        """Whether the split has its parent's labyrinths and routes, and only looks different."""
        return self.look is not Look.PLAIN


def _sampled_by(number: int, sampler: str) -> Split:
    refusal = Refusal("sampler", sampler.__eq__, f"train is sampled by {sampler} already")
    return Split(number, f"other structures, sampled by {sampler}", "test", refusals=(refusal,))


_VARIED_GOALS = Refusal(
    "goals",
    lambda goals: goals == "varied",
    "with goals=varied each labyrinth of test has a start and a goal of its own",
)
_FAR_APART = Refusal(
    "min_walls", lambda walls: walls > 1, "splits.min_walls={} keeps structures farther apart"
)
_NOISE = Refusal(
    "noise",
    lambda noise: noise > 0,
    "with demonstrations.noise the demonstrated route may not be shortest",
)
_NEEDS_LOOPS = Refusal("task", lambda task: bool(task.rules.needs_loops), "{0.rules.needs_loops}")
_NO_LOOPS = Refusal(
    "open_walls", lambda share: share == 0, "with open_walls=0 train has no loops already"
)
_ALL_LOOPS = Refusal(
    "open_walls", lambda share: share == 1, "with open_walls=1 train has all loops already"
)
_THIN = Refusal("wall_pixels", lambda pixels: pixels == 1, "walls are one pixel thick already")


class Splits(dict[str, Split]):
    """Split by name."""

    sampled = ("train", "validation", "test")
    """The splits that every dataset samples structures for."""
    base = (*sampled, "random", "s0", "s0_and_g")
    """The splits that every dataset has."""

    evaluated = ("train", "validation", "test", "s0", "s0_and_g")
    """The splits on which a trained policy is evaluated."""

    not_evaluated = ("random",)
    """The splits with another policy's episodes, in labyrinths of another split."""

    @property
    def shifts(self) -> tuple[str, ...]:
        """The splits that a dataset may add, in the order in which a dataset has them."""
        return tuple(name for name in self if name not in self.base)


SPLITS = Splits(
    {
        "train": Split(0, "demonstrations to learn from", "train"),
        "validation": Split(1, "other structures, to choose a model with", "validation"),
        "test": Split(2, "other structures again, to judge it on", "test"),
        "random": Split(
            3, "a uniformly random policy on the structures of train", "train", "train"
        ),
        "s0": Split(
            4, "the structures of train with another start", "train", "train", new_start=True
        ),
        "s0_and_g": Split(
            5,
            "the structures of train with another start and another goal",
            "train",
            "train",
            new_start=True,
            new_goal=True,
        ),
        "g": Split(6, "the structures of train with another goal", "train", "train", new_goal=True),
        "test_s0": Split(
            7,
            "the structures of test with another start",
            "test",
            "test",
            new_start=True,
            refusals=(_VARIED_GOALS,),
        ),
        "test_g": Split(
            8,
            "the structures of test with another goal",
            "test",
            "test",
            new_goal=True,
            refusals=(_VARIED_GOALS,),
        ),
        "test_s0_and_g": Split(
            9,
            "the structures of test with another start and another goal",
            "test",
            "test",
            new_start=True,
            new_goal=True,
            refusals=(_VARIED_GOALS,),
        ),
        "one_wall": Split(
            10,
            "labyrinths of train with one wall opened or shut, so that the demonstrated route is "
            "blocked or no longer shortest",
            "test",
            "train",
            new_structure=True,
            refusals=(_FAR_APART, _NOISE),
        ),
        "longer": Split(11, "routes longer than the longest of train, on other structures", "test"),
        "trees": Split(
            12, "other structures, without loops", "test", refusals=(_NEEDS_LOOPS, _NO_LOOPS)
        ),
        "open": Split(
            13,
            "other structures, each with more loops than any of train",
            "test",
            refusals=(_ALL_LOOPS,),
        ),
        "wilson": _sampled_by(14, "wilson"),
        "depth_first": _sampled_by(15, "depth_first"),
        "kruskal": _sampled_by(16, "kruskal"),
        "prim": _sampled_by(17, "prim"),
        "recoloured": Split(
            18,
            "the labyrinths and routes of test in other colours",
            "test",
            "test",
            look=Look.RECOLOURED,
        ),
        "thin_walls": Split(
            19,
            "the labyrinths and routes of test with thin walls",
            "test",
            "test",
            look=Look.THIN_WALLS,
            refusals=(_THIN,),
        ),
        "test_new_routes": Split(
            20, "other structures, none with an optimal route that train demonstrates", "test"
        ),
    }
)
"""Every split, by its name."""


def is_of_train(split: str) -> bool:
    """Return whether a split has the labyrinths of train, or at most one derived from each."""
    kind = SPLITS[split]
    return split == "train" or (kind.parent == "train" and not kind.new_structure)

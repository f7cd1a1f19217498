"""Tables and a figure for results.md: the performance of methods on every shift.

They show success rates by split and method; the effects of a new structure, start and goal, with
their interactions; and the effect of more goals in training. Intervals: 95%, over labyrinths and
seeds. `report_pages.py` writes and draws them.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import product

import numpy as np
from figures import heat_map
from kept_results import by_method, percent, rate, read_runs, solved_in, whole
from matplotlib.figure import Figure
from numpy.typing import NDArray

from labyrinth_core.data import SPLITS
from labyrinth_core.evaluation.baselines import REFERENCES
from labyrinth_core.evaluation.scores import interval
from pipeline.machinery import table

CELLS = {
    (0, 0, 0): "train",
    (0, 0, 1): "g",
    (0, 1, 0): "s0",
    (0, 1, 1): "s0_and_g",
    (1, 0, 0): "test",
    (1, 0, 1): "test_g",
    (1, 1, 0): "test_s0",
    (1, 1, 1): "test_s0_and_g",
}
"""Structure, start and goal, 1 where they are new -> split."""

EFFECTS = {
    "structure": (1, 0, 0),
    "start": (0, 1, 0),
    "goal": (0, 0, 1),
    "structure x start": (1, 1, 0),
    "structure x goal": (1, 0, 1),
    "start x goal": (0, 1, 1),
    "all three": (1, 1, 1),
}
"""Effect -> which of structure, start and goal take part in it."""

Solved = Mapping[str, NDArray[np.float64]]
"""Split -> 1 for each solved labyrinth, else 0, shape (seeds, labyrinths)."""


GOALS = {
    "fixed, 100": "shifts",
    "varied, 100": "goals/on_fixed",
    "fixed, 1,000": "goals/of_1000_control",
    "varied, 1,000": "goals/of_1000_on_fixed",
}
"""Goals and number of labyrinths in training -> the folder of BC's runs on the fixed goal."""


def methods_of() -> dict[str, Solved]:
    """Return the solved labyrinths of each method, over its seeds."""
    groups = by_method(read_runs("shifts/runs/5x5"))
    return {
        name: {split: solved_in(group, split) for split in SPLITS if split in group[0]["solved"]}
        for name, group in groups.items()
    }


def rates() -> str:
    """Return a table of success rates in percent, one row per split."""
    methods = methods_of()
    baselines = read_runs("shifts/runs/5x5", "bc-*.json")[0]["baselines"]
    rows = []
    for split in splits_of(methods):
        cells = [rate(solved[split]) for solved in methods.values()]
        labyrinths = next(iter(methods.values()))[split].shape[1]
        beside = [whole(baselines[name][split]["sr"]) for name in REFERENCES]
        rows.append([f"`{split}`", str(labyrinths), *cells, *beside])
    seeds = [str(len(solved["test"])) for solved in methods.values()]
    rows.append(["seeds", "", *seeds, *("" for _ in REFERENCES)])
    heading = ["split", "labyrinths", *methods, *(name.replace("_", " ") for name in REFERENCES)]
    return table(heading, rows)


def splits_of(methods: Mapping[str, Solved]) -> list[str]:
    """Return the splits that all methods were evaluated on."""
    return [split for split in SPLITS if all(split in solved for solved in methods.values())]


def goals() -> str:
    """Return a table of BC trained with fixed and varied goals, evaluated on the fixed goal."""
    runs = {name: read_runs(f"{folder}/runs/5x5", "bc-*.json") for name, folder in GOALS.items()}
    varied = {"100": runs["varied, 100"], "1,000": runs["varied, 1,000"]}
    rows = []
    for split in ("test", "g", "s0_and_g", "test_g", "test_s0_and_g"):
        memory = [
            whole(group[0]["baselines"]["route_memory"][split]["sr"]) for group in varied.values()
        ]
        rows.append(
            [f"`{split}`", *(rate(solved_in(group, split)) for group in runs.values()), *memory]
        )
    heading = [f"{name} ({len(group)})" for name, group in runs.items()]
    return table(["split", *heading, *(f"*memory of varied {name}*" for name in varied)], rows)


def effects() -> str:
    """Return a table of effects on the success rate in percentage points, one row per effect."""
    methods = methods_of()
    rows = [
        [name, *(percent(*effect(solved, factors)) for solved in methods.values())]
        for name, factors in EFFECTS.items()
    ]
    return table(["effect", *methods], rows)


def effect(solved: Solved, factors: tuple[int, int, int]) -> tuple[float, float, float]:
    """Return an effect in the 2 x 2 x 2 factorial of structure, start and goal, and its interval.

    The effect of a factor is the mean of the four cells where it is new, minus the mean of the
    other four. An interaction is half of the change in one factor's effect due to the other.
    Labyrinths with the same structure vary together, as do those of the same seed.
    """
    seen, unseen = (
        sum(
            np.prod(
                [2 * level - 1 for level, taken in zip((new, *rest), factors, strict=True) if taken]
            )
            * solved[CELLS[(new, *rest)]]
            / 4
            for rest in product((0, 1), repeat=2)
        )
        for new in (0, 1)
    )
    # The effect of a new structure alone adds all cells of a labyrinth; others subtract half.
    ends = (0.0, 1.0) if factors == EFFECTS["structure"] else (-0.5, 0.5)
    return float(unseen.mean() + seen.mean()), *interval(unseen, -seen, ends)


def draw() -> Figure:
    """Return a heat map of the success rates by split and method."""
    methods = methods_of()
    splits = splits_of(methods)
    shares = 100 * np.array([[of[split].mean() for of in methods.values()] for split in splits])
    return heat_map(shares, splits, list(methods))

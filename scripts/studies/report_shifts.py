"""Make tables and a figure of how methods fare on every shift, from their evaluations.

    python scripts/studies/report_shifts.py --figures docs/pictures
    python scripts/studies/report_shifts.py --results docs/results/goals

Prints Markdown: success rates by split and method, and the effects of structure, start and goal,
each as in train or new, with their interactions, unless a split is missing that these need.
Intervals: 95% bootstrap over labyrinths and seeds. The figure is a PNG and an SVG.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from itertools import product
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from report_ablation import STYLE, save

from labyrinth_core.data.splits import SPLITS
from labyrinth_core.evaluation.baselines import REFERENCES
from labyrinth_core.evaluation.intervals import interval
from labyrinth_core.evaluation.results import Results
from pipeline.machinery.markdown import table
from pipeline.studies.results.figures import run_of, solved_in
from pipeline.studies.results.kept import read_runs
from pipeline.studies.results.paper import METHODS

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
"""Effect -> which of the three it is about."""

Solved = Mapping[str, NDArray[np.float64]]
"""Split -> 1 for each labyrinth that was solved, else 0, shape (seeds, labyrinths)."""


def main() -> None:
    """Print the tables and draw the figure."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--results", type=Path, default=Path("docs/results/shifts"))
    parser.add_argument("--figures", type=Path, help="folder for the figure")
    given = parser.parse_args()
    runs = read_runs(given.results)
    methods = by_method(runs)
    baselines = runs[0].baselines
    print(rates(methods, baselines))
    if set(CELLS.values()) <= set(splits_of(methods)):
        print("", effects(methods), sep="\n")
    if given.figures is not None:
        with mpl.rc_context(STYLE):
            save(draw(methods), given.figures / "shifts")


def by_method(runs: Sequence[Results]) -> dict[str, Solved]:
    """Return what was solved by each method, over its seeds."""
    groups: dict[str, list[Results]] = {}
    for each in runs:
        method = run_of(each).method
        groups.setdefault(METHODS.get(method, method), []).append(each)
    return {
        name: {
            split: solved_in(group, split)
            for split in SPLITS
            if all(split in each.splits for each in group)
        }
        for name, group in groups.items()
    }


def rates(methods: Mapping[str, Solved], baselines: Mapping[str, Any]) -> str:
    """Return a table of success rates in percent, with a row for each split.

    `baselines` are those of any of the evaluations, which are of one dataset.
    """
    rows = []
    for split in splits_of(methods):
        cells = [
            percent(solved[split].mean(), *interval(solved[split])) for solved in methods.values()
        ]
        labyrinths = next(iter(methods.values()))[split].shape[1]
        beside = [f"{100 * baselines[name][split]['sr']:.0f}" for name in REFERENCES]
        rows.append([f"`{split}`", str(labyrinths), *cells, *beside])
    seeds = [str(len(solved["test"])) for solved in methods.values()]
    rows.append(["seeds", "", *seeds, *("" for _ in REFERENCES)])
    heading = ["split", "labyrinths", *methods, *(name.replace("_", " ") for name in REFERENCES)]
    return table(heading, rows, "l" + "r" * (len(heading) - 1))


def splits_of(methods: Mapping[str, Solved]) -> list[str]:
    """Return the splits that all methods were evaluated on."""
    return [split for split in SPLITS if all(split in solved for solved in methods.values())]


def percent(mean: float, low: float, high: float) -> str:
    """Return a share and its interval, in percent."""
    return f"{round(100 * mean)} [{round(100 * low)}, {round(100 * high)}]"


def effects(methods: Mapping[str, Solved]) -> str:
    """Return a table of effects in points of success, with a row for each."""
    rows = [
        [name, *(percent(*effect(solved, factors)) for solved in methods.values())]
        for name, factors in EFFECTS.items()
    ]
    return table(["effect", *methods], rows, "l" + "r" * len(methods))


def effect(solved: Solved, factors: tuple[int, int, int]) -> tuple[float, float, float]:
    """Return an effect in the two-level factorial of structure, start and goal, and its interval.

    The effect of one factor is the mean of the four cells where it is new less that of the others.
    An interaction is half of how much the effect of one changes with the other. Labyrinths of one
    structure are resampled together, as are those of one seed.
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
    return float(unseen.mean() + seen.mean()), *interval(unseen, -seen)


def draw(methods: Mapping[str, Solved]) -> Figure:
    """Return a heat map: how much each method solves of each split."""
    splits = splits_of(methods)
    shares = 100 * np.array([[of[split].mean() for of in methods.values()] for split in splits])
    return heat_map(shares, splits, list(methods))


def heat_map(shares: NDArray[np.float64], rows: Sequence[str], columns: Sequence[str]) -> Figure:
    """Return a heat map of shares in percent, shape (rows, columns), with the figures in it."""
    figure = Figure(figsize=(6.4, 0.6 + 0.27 * len(rows)), layout="constrained")
    panel = figure.subplots()
    image = panel.imshow(shares, cmap="cividis", vmin=0, vmax=100, aspect="auto")
    panel.set_xticks(range(len(columns)), columns)
    panel.set_yticks(range(len(rows)), rows)
    panel.tick_params(length=0, labeltop=True, labelbottom=False)
    for (row, column), share in np.ndenumerate(shares):
        colour = "white" if share < 50 else "black"
        panel.text(column, row, f"{share:.0f}", ha="center", va="center", color=colour)
    figure.colorbar(image, ax=panel, label="% solved", shrink=0.6)
    return figure


if __name__ == "__main__":
    main()

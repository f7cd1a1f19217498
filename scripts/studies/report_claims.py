"""Make the tables and the figure of what the methods can be said to do, and what that cost.

    python scripts/studies/report_claims.py --data-dir data/thousand --figures docs/pictures

Prints Markdown: success on the 1,000 labyrinths of test in `docs/results/thousand/runs`, where
train demonstrates an optimal route and where it does not, in all and in those with shortest routes
alike in length, beside what needs no learning; which methods differ by more than chance; and the
hours of all runs kept in `docs/results`, by method. Intervals: 95% bootstrap over labyrinths and
seeds. The figure is a PNG and an SVG.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping, Sequence
from itertools import groupby
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from report_ablation import COLOURS, STYLE, save
from report_shifts import percent

from labyrinth_core.data.schema import read_json
from labyrinth_core.evaluation.baselines import REFERENCES
from labyrinth_core.evaluation.intervals import interval
from labyrinth_core.evaluation.labyrinth_arrays import load_arrays
from labyrinth_core.evaluation.results import Results
from pipeline.machinery.markdown import table
from pipeline.studies.results.comparison import (
    SPLIT,
    interquartile_mean,
    pairs_of_methods,
    rates_of,
)
from pipeline.studies.results.figures import run_of, solved_in
from pipeline.studies.results.kept import read_runs
from pipeline.studies.results.paper import name_of

Groups = Mapping[str, Sequence[Results]]
"""The runs of each method, one for each seed."""

PARTS = {"known": "train demonstrates an optimal route", "new": "train demonstrates none"}
"""Part of the labyrinths -> what it is."""

Parts = Mapping[str, NDArray[np.bool_]]
"""Part of the labyrinths -> whether each labyrinth is in it, shape (L,)."""


def main() -> None:
    """Print the tables and draw the figure."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--results", type=Path, default=Path("docs/results"))
    parser.add_argument("--data-dir", type=Path, required=True, help="with the 1,000 labyrinths")
    parser.add_argument("--figures", type=Path, help="folder for the figure")
    given = parser.parse_args()
    found = read_runs(given.results / "thousand")
    groups = {
        name_of(method): list(runs)
        for method, runs in groupby(found, lambda each: run_of(each).method)
    }
    parts = parts_of(found[0], given.data_dir)
    pairs = pairs_of_methods(rates_of(found))
    routes = (f"Of {lengths}:\n\n{by_route(groups, each)}" for lengths, each in parts.items())
    print(rates(groups), *routes, *pairs, costs(given.results), sep="\n\n")
    if given.figures is not None:
        with mpl.rc_context(STYLE):
            save(draw(groups, parts), given.figures / "claims")


def parts_of(results: Results, data_dir: Path) -> dict[str, Parts]:
    """Return the parts of the labyrinths of the split: of all, and of those with usual lengths."""
    arrays = load_arrays(data_dir, results.config, SPLIT, observation="vector")
    known = results.splits[SPLIT].known_route
    assert known is not None
    usual = int(np.bincount(arrays.distance).argmax())
    like = arrays.distance == usual
    return {
        "all lengths": {"known": known, "new": ~known},
        f"shortest routes of {usual} moves": {"known": known & like, "new": ~known & like},
    }


def rates(groups: Groups) -> str:
    """Return a table with a row for each method, and for each reference."""
    heading = ["", "seeds", "SR", "interquartile mean", "SPL"]
    rows = []
    for name, runs in groups.items():
        solved = solved_in(runs, SPLIT)
        middle = f"{100 * interquartile_mean([solved.mean(axis=1)]).value:.0f}"
        spl = np.mean([each.splits[SPLIT].spl for each in runs])
        rows.append([name, str(len(runs)), _percent(solved), middle, f"{100 * spl:.0f}"])
    references = next(iter(groups.values()))[0].baselines
    for name in (*REFERENCES, "random", "oracle"):
        sr, spl = (f"{100 * references[name][SPLIT][figure]:.0f}" for figure in ("sr", "spl"))
        rows.append([f"*{name.replace('_', ' ')}*", "", sr, "", spl])
    return table(heading, rows, "l" + "r" * (len(heading) - 1))


def by_route(groups: Groups, parts: Parts) -> str:
    """Return a table of success in two parts of the labyrinths, with a row for each method."""
    heading = ["", *(f"{name} ({which.sum()})" for name, which in parts.items()), "difference"]
    rows = [[name, *_compared(solved_in(runs, SPLIT), parts)] for name, runs in groups.items()]
    return table(heading, rows, "l" + "r" * (len(heading) - 1))


def _compared(solved: NDArray[np.float64], parts: Parts) -> Iterator[str]:
    """Yield the success rate in each of two parts, and by how much the first is higher."""
    first, second = (solved[:, which] for which in parts.values())
    yield from map(_percent, (first, second))
    yield percent(first.mean() - second.mean(), *interval(first, second))


def _percent(solved: NDArray[np.float64]) -> str:
    return percent(solved.mean(), *interval(solved))


def draw(groups: Groups, parts: Mapping[str, Parts]) -> Figure:
    """Return a figure of success with and without a route to remember, a row for each method."""
    figure = Figure(figsize=(7.2, 1.0 + 0.3 * len(groups)), layout="constrained")
    panels = figure.subplots(1, len(parts), sharey=True)
    rows = np.arange(len(groups))[::-1]
    for panel, (lengths, each) in zip(panels, parts.items(), strict=True):
        for place, (name, which) in enumerate(each.items()):
            solved = [solved_in(runs, SPLIT)[:, which] for runs in groups.values()]
            middle = np.array([some.mean() for some in solved])
            low, high = np.array([interval(some) for some in solved]).T
            panel.errorbar(
                100 * middle,
                rows + 0.12 - 0.24 * place,
                xerr=100 * np.maximum([middle - low, high - middle], 0),
                fmt="o",
                ms=5,
                color=COLOURS[place],
                label=PARTS[name],
            )
        panel.set(xlim=(-3, 103), xlabel=f"% solved of {SPLIT}, 5x5", title=lengths)
        panel.grid(axis="x", alpha=0.3)
    panels[0].set_yticks(rows, list(groups))
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper center", ncols=2)
    return figure


def costs(results: Path) -> str:
    """Return a table of runs and core-hours by method, of all runs that are kept in a folder."""
    found: dict[str, dict[tuple[Any, ...], float]] = {}
    for content in _kept(results):
        if "variant" in content:  # Of scripts/studies/ablate.py.
            method, seconds = content["variant"], content["cpu_seconds"]
            method = "BC" if method.startswith("bc") else "planner"
            key = tuple(str(content[name]) for name in ("config", "variant", "labyrinths", "seed"))
        else:
            run = content["run"]
            seconds = content.get("seconds_of_training", run.get("training", {}).get("seconds"))
            method = name_of(run["method"])
            key = (run["fingerprint"], run["seed"], seconds)  # Evaluated on several datasets.
        found.setdefault(method, {})[key] = seconds
    rows = [
        [method, str(len(runs)), f"{sum(runs.values()) / 3600:.1f}"]
        for method, runs in found.items()
    ]
    runs = str(sum(len(each) for each in found.values()))
    hours = sum(sum(each.values()) for each in found.values()) / 3600
    return table(["method", "runs", "hours"], [*rows, ["all", runs, f"{hours:.1f}"]], "lrr")


def _kept(results: Path) -> Iterator[dict[str, Any]]:
    """Yield the content of each file that describes a run with the time that it took."""
    for path in sorted(results.rglob("*.json")):
        content = read_json(path)
        if content.get("kind") or content.keys() & {"cpu_seconds", "seconds_of_training"}:
            yield content


if __name__ == "__main__":
    main()

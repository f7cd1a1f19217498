"""A table and a figure for results.md: PPO and DQN trained on the environment.

From files of an archived study (docs/results/ARCHIVE.md). `report_pages.py` writes and draws them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import product
from typing import Any

import numpy as np
from figures import COLOURS, INK
from kept_results import Run, grouped, read_runs, whole
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter
from numpy.typing import NDArray

from pipeline.machinery import table

SIZES = ("3x3", "5x5")
METHODS = ("PPO", "DQN")
LABYRINTHS = {"fixed": "labyrinths of train", "fresh": "fresh labyrinths"}
"""The labyrinths that a run learnt from -> name in print."""
SPLITS = ("train", "test")
FIGURES = ("spl", "sr")


def groups_of() -> dict[tuple[Any, ...], list[Run]]:
    """Return the runs by size, method and training labyrinths, one for each seed."""
    runs = (each["run"] | each for each in read_runs("reinforcement"))
    groups = grouped(runs, "config", "method", "labyrinths")
    return {key: groups[key] for key in product(SIZES, METHODS, LABYRINTHS) if key in groups}


def curve(runs: Sequence[Run], split: str, figure: str = "spl") -> NDArray[np.float64]:
    """Return `figure` on a split in percent, shape (seeds, checkpoints)."""
    return 100 * np.array([[each[split][figure] for each in run["checkpoints"]] for run in runs])


def rates() -> str:
    """Return a table of SPL and SR after the last step, also of BC and two baselines."""
    groups, rows = groups_of(), []
    for size in SIZES:
        for (config, method, labyrinths), runs in groups.items():
            if config == size:
                cells = [last(runs, split, figure) for split in SPLITS for figure in FIGURES]
                minutes = np.mean([run["seconds_of_training"] for run in runs]) / 60
                steps = f"{runs[0]['run']['steps']:,}"
                name = f"{method}, {LABYRINTHS[labyrinths]}"
                rows.append([size, name, str(len(runs)), steps, *cells, f"{minutes:.1f}"])
        rows += references(size)
    figures = [f"{split}: {figure.upper()}" for split in SPLITS for figure in FIGURES]
    heading = ["size", "method, what it learns from", "seeds", "steps", *figures, "minutes a run"]
    return table(heading, rows, "llrrrrrrr")


def last(runs: Sequence[Run], split: str, figure: str) -> str:
    """Return the mean over seeds after the last step, with the worst and best if they differ."""
    found = curve(runs, split, figure)[:, -1]
    mean, low, high = (f"{each:.0f}" for each in (found.mean(), found.min(), found.max()))
    return mean if low == high else f"{mean} ({low} to {high})"


def references(size: str) -> Iterator[list[str]]:
    """Yield rows of BC, which observes pictures, and of two baselines without training."""
    runs = bc(size)
    shares = [
        np.mean([run["splits"][split][figure] for run in runs])
        for split in SPLITS
        for figure in FIGURES
    ]
    beside = {name: runs[0]["baselines"][name] for name in ("route_memory", "random")}
    yield [size, "*BC, demonstrations of train*", str(len(runs)), "", *map(whole, shares), ""]
    for name, found in beside.items():
        cells = [whole(found[split][figure]) for split in SPLITS for figure in FIGURES]
        yield [size, f"*{name.replace('_', ' ')}*", "", "", *cells, ""]


def bc(size: str) -> list[Run]:
    """Return the runs of BC on the same dataset."""
    return read_runs(f"runs/{size}", "bc-cnn-seed?.json")


def draw() -> Figure:
    """Return a figure of SPL by steps, on train and test, with a panel for each method and size."""
    groups = groups_of()
    figure = Figure(figsize=(7.2, 4.6), layout="constrained")
    panels = figure.subplots(len(SIZES), len(METHODS), sharey=True, squeeze=False)
    for (size, method, labyrinths), runs in groups.items():
        panel = panels[SIZES.index(size)][METHODS.index(method)]
        colour = COLOURS[list(LABYRINTHS).index(labyrinths)]
        steps = [each["steps"] for each in runs[0]["checkpoints"]]
        for split, line in zip(SPLITS, (":", "-"), strict=True):
            found = curve(runs, split)
            if len(runs) > 1:
                panel.fill_between(
                    steps, found.min(axis=0), found.max(axis=0), color=colour, alpha=0.12, lw=0
                )
            label = f"{LABYRINTHS[labyrinths]}, on {split}"
            panel.plot(steps, found.mean(axis=0), line, color=colour, label=label)
        panel.set(title=f"{method}, {size}", xlim=(0, None), ylim=(-3, 103))
        panel.xaxis.set_major_formatter(FuncFormatter(lambda x, _: f"{x / 1000:.0f}"))
        panel.grid(alpha=0.3)
    for row, size in zip(panels, SIZES, strict=True):
        spl = 100 * np.mean([run["splits"]["test"]["spl"] for run in bc(size)])
        for panel in row:
            panel.axhline(spl, color=INK, lw=0.9, ls="--", label="demonstrations (BC), on test")
        row[0].set_ylabel("SPL, %")
    for panel in panels[-1]:
        panel.set_xlabel("thousand steps")
    handles, labels = panels[0, 0].get_legend_handles_labels()
    figure.legend(
        handles,
        labels,
        title="What it learns from, and the split that is evaluated",
        loc="outside upper center",
        ncols=3,
    )
    return figure

"""Tables and figures for generalisation.md: ablations of the planner, and numbers of labyrinths.

The results come from an archived study (docs/results/ARCHIVE.md). Intervals: 95%, over seeds and
labyrinths. `report_pages.py` writes and draws them.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from figures import COLOURS, draw_rates
from kept_results import Run, bounds, grouped, rate, read_runs, solved_in, whole
from matplotlib.figure import Figure

from pipeline.machinery import table
from pipeline.results.leaderboard import name_of

SETS = ("train", "test", "s0", "s0_and_g", "test, new ends", "fresh")
"""The sets of labyrinths in the tables."""
SHOWN = {"test": "test", "test, new ends": "test, another start and goal"}
"""Set of labyrinths in the figures -> its name there."""
Groups = dict[tuple[Any, ...], list[Run]]
"""Runs that differ only in the seed, by the values that they share."""


def worth(group: Sequence[Run]) -> float:
    """Return the score by which variants are sorted."""
    return sum(float(solved_in(group, name).mean()) for name in SHOWN)


def usual() -> Groups:
    """Return the runs on the usual number of labyrinths, by config and variant."""
    runs = read_runs("ablation", "*/*.json")
    return grouped((each for each in runs if each["usual"]), "config", "variant")


def samples() -> Groups:
    """Return the runs of variants that were trained on several numbers of labyrinths."""
    runs = read_runs("ablation/5x5")
    counted = {each["variant"] for each in runs if not each["usual"]}
    return grouped((each for each in runs if each["variant"] in counted), "variant", "labyrinths")


def sets_of(group: Sequence[Run], names: Iterable[str]) -> list[str]:
    """Return the cells of a row: the success rates on sets of labyrinths."""
    return [rate(solved_in(group, name)) for name in names]


def ingredients() -> str:
    """Return a table of the variants at 5x5, one row each, the best first."""
    groups = [group for (config, _), group in usual().items() if config == "5x5"]
    rows = []
    for group in sorted(groups, key=worth, reverse=True):
        seconds = float(np.mean([each["cpu_seconds"] for each in group]))
        cells = sets_of(group, SETS[1:])
        rows.append([named(group[0]["variant"]), *cells, str(len(group)), f"{seconds:.0f}"])
    return table(["% solved", *map(shown, SETS[1:]), "seeds", "CPU s"], rows)


def named(variant: str) -> str:
    """Return the name of a variant in print, with options as code."""
    if variant == "without grid and colour":
        return "without `grid_prior` and `colour_prior`"
    if variant == "bc with ingredients":
        return "BC with `augment`, `relabel`, `average`"
    without, space, option = variant.partition(" ")
    return f"{without} `{option}`" if space else name_of(variant)


def shown(name: str) -> str:
    """Return the name of a set in print."""
    name = name.replace("new ends", "new start and goal")
    return f"`{name}`" if name.startswith("s0") else name


def without_grid() -> str:
    """Return a table of the seeds without `grid_prior` and `colour_prior`."""
    runs = usual()["5x5", "without grid and colour"]
    sets = ("test", "s0", "s0_and_g", "validation, new ends", "test, new ends", "fresh")
    cells = [
        [str(run["seed"]), *(whole(run["solved"][name].mean()) for name in sets)] for run in runs
    ]
    return table(["seed", *map(shown, sets)], cells)


def by_number() -> str:
    """Return a table of success rates by the number of training labyrinths."""
    rows = [
        [
            name_of(variant),
            f"{labyrinths:,}",
            *sets_of(group, SETS[1:2] + SETS[4:]),
            str(len(group)),
        ]
        for (variant, labyrinths), group in samples().items()
    ]
    rows.sort(key=lambda row: row[0] == "BC")
    return table(["% solved", "of labyrinths", *map(shown, SETS[1:2] + SETS[4:]), "seeds"], rows)


def tasks() -> str:
    """Return a table of the planner on other tasks."""
    groups = {config: group for (config, _), group in usual().items() if "-" in config}
    rows = [
        [config.partition("-")[2].replace("_", " "), *sets_of(groups[config], SETS)]
        for config in sorted(groups, key=lambda config: -worth(groups[config]))
    ]
    return table(["% solved", *map(shown, SETS)], rows)


def draw_ingredients() -> Figure:
    """Return a figure of the ablations, with a panel for each size and a line for each variant."""
    groups = usual()
    sizes = sorted({config for config, _ in groups if "-" not in config})
    variants = [variant for config, variant in groups if config == sizes[-1]]
    variants.sort(key=lambda variant: worth(groups[sizes[-1], variant]))
    figure = Figure(figsize=(7.2, 0.9 + 0.27 * len(variants)), layout="constrained")
    panels = figure.subplots(1, len(sizes), sharey=True, squeeze=False)[0]
    for panel, size in zip(panels, sizes, strict=True):
        there = [variant for variant in variants if (size, variant) in groups]
        for place, (name, label) in enumerate(SHOWN.items()):
            solved = [solved_in(groups[size, variant], name) for variant in there]
            heights = [variants.index(variant) for variant in there]
            draw_rates(panel, heights, solved, place, ms=4, label=label)
        panel.set(title=size, xlabel="% solved")
    panels[0].set_yticks(range(len(variants)), variants)
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper center", ncols=2)
    return figure


def draw_samples() -> Figure:
    """Return a figure of success rates by the number of labyrinths, with a panel for each set."""
    groups = samples()
    figure = Figure(figsize=(7.2, 2.8), layout="constrained")
    panels = figure.subplots(1, len(SHOWN), sharey=True)
    for panel, (name, label) in zip(panels, SHOWN.items(), strict=True):
        for place, variant in enumerate(sorted({variant for variant, _ in groups}, reverse=True)):
            of_variant = {
                count: group for (name_, count), group in groups.items() if name_ == variant
            }
            rates = [bounds(solved_in(group, name)) for group in of_variant.values()]
            mean, low, high = 100 * np.array(rates).T
            panel.fill_between(list(of_variant), low, high, color=COLOURS[place], alpha=0.2, lw=0)
            panel.plot(list(of_variant), mean, "o-", ms=4, color=COLOURS[place], label=variant)
        panel.set(xscale="log", title=label, xlabel="labyrinths trained on", ylim=(-3, 103))
        panel.grid(alpha=0.3)
    panels[0].set_ylabel("% solved")
    panels[0].legend(frameon=False)
    return figure

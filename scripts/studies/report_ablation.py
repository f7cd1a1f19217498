"""What the planner's ingredients and labyrinths are worth, and its controls: generalisation.md.

Tables and figures of the results of ablate.py, controls.py and generalise.py. Intervals: 95%
bootstrap over seeds and labyrinths. `report_pages.py` writes and draws them.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from kept_results import Run, by_seed, rate, read_runs, solved_in, whole
from matplotlib.figure import Figure
from numpy.typing import NDArray

from labyrinth_core.evaluation.intervals import interval
from labyrinth_core.pictures.renderer import DEFAULT_STYLE
from pipeline.machinery.markdown import table
from pipeline.studies.results.paper import name_of

SETS = ("train", "test", "s0", "s0_and_g", "test, new ends", "fresh")
"""The sets of labyrinths in the tables."""
SHOWN = {"test": "test", "test, new ends": "test, another start and goal"}
"""The sets of labyrinths in the figures, and their names there."""
COLOURS = [np.array(colour) / 255 for colour in (DEFAULT_STYLE.goal, DEFAULT_STYLE.start)]

Groups = dict[tuple[Any, ...], list[Run]]
"""Runs that differ in the seed alone, by the values that they have in common."""


def grouped(results: Iterable[Run], *names: str) -> Groups:
    """Return results grouped by the values of some names."""
    groups: Groups = {}
    for each in results:
        groups.setdefault(tuple(each[name] for name in names), []).append(each)
    return dict(sorted(groups.items()))


def bounds(group: Sequence[Run], name: str) -> tuple[float, float, float]:
    """Return the success rate on a set, and its interval, in percent."""
    solved = solved_in(group, name)
    low, high = interval(solved)
    return 100 * float(solved.mean()), 100 * low, 100 * high


def worth(group: Sequence[Run]) -> float:
    """Return a score of runs by which they are ordered."""
    return sum(float(solved_in(group, name).mean()) for name in SHOWN)


def usual(results: Path) -> Groups:
    """Return the runs on the usual number of labyrinths, by config and variant."""
    runs = read_runs(results / "ablation", "*/*.json")
    return grouped((each for each in runs if each["usual"]), "config", "variant")


def samples(results: Path) -> Groups:
    """Return the runs of the variants that were tried on several numbers of labyrinths."""
    runs = read_runs(results / "ablation/5x5")
    counted = {each["variant"] for each in runs if not each["usual"]}
    return grouped((each for each in runs if each["variant"] in counted), "variant", "labyrinths")


def sets_of(group: Sequence[Run], names: Iterable[str]) -> list[str]:
    """Return the cells of some sets of labyrinths."""
    return [rate(solved_in(group, name)) for name in names]


def ingredients(results: Path) -> str:
    """Return a table with a row for each variant at 5x5, the best first."""
    groups = [group for (config, _), group in usual(results).items() if config == "5x5"]
    rows = []
    for group in sorted(groups, key=worth, reverse=True):
        seconds = float(np.mean([each["cpu_seconds"] for each in group]))
        cells = sets_of(group, SETS[1:])
        rows.append([named(group[0]["variant"]), *cells, str(len(group)), f"{seconds:.0f}"])
    return table(["% solved", *map(shown, SETS[1:]), "seeds", "CPU s"], rows)


def named(variant: str) -> str:
    """Return a variant in print: options as code."""
    if variant == "without grid and colour":
        return "without `grid_prior` and `colour_prior`"
    if variant == "bc with ingredients":
        return "BC with `augment`, `relabel`, `average`"
    without, space, option = variant.partition(" ")
    return f"{without} `{option}`" if space else name_of(variant)


def shown(name: str) -> str:
    """Return a set in print."""
    name = name.replace("new ends", "new start and goal")
    return f"`{name}`" if name.startswith("s0") else name


def without_grid(results: Path) -> str:
    """Return a table of the seeds without the grid and the colour."""
    runs = usual(results)["5x5", "without grid and colour"]
    sets = ("test", "s0", "s0_and_g", "validation, new ends", "test, new ends", "fresh")
    cells = [
        [str(run["seed"]), *(whole(run["solved"][name].mean()) for name in sets)] for run in runs
    ]
    return table(["seed", *map(shown, sets)], cells)


def by_number(results: Path) -> str:
    """Return a table with a row for each number of labyrinths."""
    rows = [
        [
            name_of(variant),
            f"{labyrinths:,}",
            *sets_of(group, SETS[1:2] + SETS[4:]),
            str(len(group)),
        ]
        for (variant, labyrinths), group in sorted(samples(results).items(), reverse=False)
    ]
    rows.sort(key=lambda row: row[0] == "BC")
    return table(["% solved", "of labyrinths", *map(shown, SETS[1:2] + SETS[4:]), "seeds"], rows)


def tasks(results: Path) -> str:
    """Return a table of the planner with other tasks."""
    groups = {config: group for (config, _), group in usual(results).items() if "-" in config}
    rows = [
        [config.partition("-")[2].replace("_", " "), *sets_of(groups[config], SETS)]
        for config in sorted(groups, key=lambda config: -worth(groups[config]))
    ]
    return table(["% solved", *map(shown, SETS)], rows)


def planner_by_seed(results: Path) -> str:
    """Return a table of three seeds: the splits in eight views, and other labyrinths in one."""
    runs = read_runs(results / "runs/5x5", "planner-*.json")
    larger = read_runs(results / "larger", "planner-*.json")
    splits = {name: shown(name) for name in ("train", "validation", "test", "s0", "s0_and_g")}
    other = {
        "validation, new ends": "structures of validation, new start and goal",
        "test, new ends": "structures of test, new start and goal",
        "fresh": "fresh labyrinths of another seed",
        **{f"fresh {size}": size for size in ("7x7", "10x10", "15x15", "25x25")},
    }
    heading = ["% solved, of 100", *(f"seed {run['run']['seed']}" for run in runs)]
    return table(heading, by_seed(runs, splits) + by_seed(larger, other))


def exchanged(results: Path) -> str:
    """Return a table of the runs with two actions exchanged."""
    groups = grouped(read_runs(results / "controls/exchanged/5x5"), "variant")
    rows = [
        [
            variant,
            *(whole(solved_in(group, name).mean()) for name in ("train", "test")),
            str(len(group)),
        ]
        for (variant,), group in groups.items()
    ]
    return table(["% solved", "train", "test", "seeds"], rows)


def powers(results: Path) -> str:
    """Return a table of the powers to which the planner raises costs, and of those by the rule."""
    (run,) = read_runs(results / "controls/powers")
    of_sets: dict[str, dict[str, str]] = {}
    for name, solved in run["solved"].items():
        of_set, _, power = name.rpartition(" at ")
        of_sets.setdefault(of_set, {})[power] = whole(solved.mean())
    rows = []
    for name, cells in of_sets.items():
        *fixed, (needed, by_rule) = cells.items()
        plain = name.removeprefix("fresh ")
        rows.append([plain, *(cell for _, cell in fixed), f"{by_rule} ({float(needed):.1f})"])
    tried = [power for power, _ in fixed]
    return table(["power", f"{tried[0]}, as learnt", *tried[1:], "by the rule"], rows)


def looks(results: Path) -> str:
    """Return a table of other looks, the seeds of a method in one cell."""
    runs = read_runs(results / "controls/looks")
    methods = {
        name: [each for each in runs if each["method"] == name] for name in ("planner", "bc")
    }
    rows = [
        [
            look,
            *(
                ", ".join(whole(each["solved"][look].mean()) for each in group)
                for group in methods.values()
            ),
        ]
        for look in runs[0]["solved"]
    ]
    return table(["look", *map(name_of, methods)], rows)


PEERS: dict[str, tuple[str, str]] = {
    "planner": ("runs/5x5", "planner-*.json"),
    "`method=walls`": ("peers/runs/5x5", "walls-*.json"),
    "`method=vin`, 30 epochs": ("peers/runs/5x5", "vin-*.json"),
    "the same with `augment` and `relabel`": ("peers/relabelled/5x5", "vin-*.json"),
    "`method=vin`, 150 epochs": ("peers/longer/5x5", "vin-*.json"),
}
"""Name in print -> the folder and the pattern of the runs."""


def peers(results: Path) -> str:
    """Return a table of the planner and its peers on the splits."""
    splits, rows = ("train", "validation", "test", "s0", "s0_and_g"), []
    for name, (folder, pattern) in PEERS.items():
        runs = read_runs(results / folder, pattern)
        cells = (whole(solved_in(runs, split).mean()) for split in splits)
        rows.append([name, str(len(runs)), *cells])
    return table(["5x5, % solved", "seeds", *map(shown, splits)], rows)


def draw_ingredients(results: Path) -> Figure:
    """Return a figure with a panel for each size, and a line for each variant."""
    groups = usual(results)
    sizes = sorted({config for config, _ in groups if "-" not in config})
    variants = [variant for config, variant in groups if config == sizes[-1]]
    variants.sort(key=lambda variant: worth(groups[sizes[-1], variant]))
    figure = Figure(figsize=(7.2, 0.9 + 0.27 * len(variants)), layout="constrained")
    panels = figure.subplots(1, len(sizes), sharey=True, squeeze=False)[0]
    for panel, size in zip(panels, sizes, strict=True):
        there = [variant for variant in variants if (size, variant) in groups]
        for place, (name, label) in enumerate(SHOWN.items()):
            rates = [bounds(groups[size, variant], name) for variant in there]
            mean, low, high = np.array(rates).T
            heights = np.array([variants.index(variant) for variant in there]) + 0.12 - 0.24 * place
            errors = np.maximum([mean - low, high - mean], 0)
            style = {"fmt": "o", "ms": 4, "color": COLOURS[place], "label": label}
            panel.errorbar(mean, heights, xerr=errors, **style)
        panel.set(title=size, xlim=(-3, 103), xlabel="% solved")
        panel.grid(axis="x", alpha=0.3)
    panels[0].set_yticks(range(len(variants)), variants)
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper center", ncols=2)
    return figure


def draw_samples(results: Path) -> Figure:
    """Return a figure of success rates by the number of labyrinths, a panel for each set."""
    groups = samples(results)
    figure = Figure(figsize=(7.2, 2.8), layout="constrained")
    panels = figure.subplots(1, len(SHOWN), sharey=True)
    for panel, (name, label) in zip(panels, SHOWN.items(), strict=True):
        for place, variant in enumerate(sorted({variant for variant, _ in groups}, reverse=True)):
            of_variant = {
                count: group for (name_, count), group in groups.items() if name_ == variant
            }
            mean, low, high = np.array([bounds(group, name) for group in of_variant.values()]).T
            panel.fill_between(list(of_variant), low, high, color=COLOURS[place], alpha=0.2, lw=0)
            panel.plot(list(of_variant), mean, "o-", ms=4, color=COLOURS[place], label=variant)
        panel.set(xscale="log", title=label, xlabel="labyrinths trained on", ylim=(-3, 103))
        panel.grid(alpha=0.3)
    panels[0].set_ylabel("% solved")
    panels[0].legend(frameon=False)
    return figure


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

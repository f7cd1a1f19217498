r"""Make tables and figures of the results of ablate.py and generalise.py.

    python scripts/studies/report_ablation.py --figures docs/pictures
    python scripts/studies/report_ablation.py --results docs/results/controls/exchanged \
        --larger docs/results/controls/looks

Prints Markdown tables of the ingredients and tasks, of the number of labyrinths, and of larger
labyrinths by seed. Figures are PNG and SVG. Intervals: 95% bootstrap over seeds and labyrinths.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from labyrinth_sets import read_results
from matplotlib.figure import Figure

from labyrinth_core.evaluation.intervals import interval
from labyrinth_core.pictures.renderer import DEFAULT_STYLE
from pipeline.machinery.markdown import table

INK = "#767676"
STYLE: dict[Any, Any] = {
    # Legible on the white and on the dark page.
    **dict.fromkeys(
        ("text.color", "axes.labelcolor", "axes.edgecolor", "xtick.color", "ytick.color"), INK
    ),
    "legend.frameon": False,
    "savefig.transparent": True,
    "svg.hashsalt": "labyrinth-datasets",
    "font.size": 9,
    "axes.titlesize": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
}
SETS = ("train", "test", "s0", "s0_and_g", "test, new ends", "fresh")
"""The sets of labyrinths in the tables."""
SHOWN = {"test": "test", "test, new ends": "test, another start and goal"}
"""The sets of labyrinths in the figures, and their names there."""
COLOURS = [np.array(colour) / 255 for colour in (DEFAULT_STYLE.goal, DEFAULT_STYLE.start)]

Results = dict[str, Any]
Groups = dict[tuple[Any, ...], list[Results]]
"""Runs that differ in the seed alone, by the values that they have in common."""


def main() -> None:
    """Print the tables and draw the figures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--results", type=Path, default=Path("results/ablation"))
    parser.add_argument("--larger", type=Path, default=Path("results/larger"))
    parser.add_argument("--figures", type=Path, help="folder for the figures")
    given = parser.parse_args()
    found = [read_results(path) for path in sorted(given.results.glob("*/*.json"))]
    usual = grouped([each for each in found if each["usual"]], "config", "variant")
    counted = {(each["config"], each["variant"]) for each in found if not each["usual"]}
    samples = grouped(
        [each for each in found if (each["config"], each["variant"]) in counted],
        *("variant", "labyrinths"),
    )
    best_first = dict(sorted(usual.items(), key=lambda item: (item[0][0], -worth(item[1]))))
    larger = [read_results(path) for path in sorted(given.larger.glob("*.json"))]
    print(as_table(best_first), as_table(samples), by_seed(larger), sep="\n\n")
    if given.figures is not None:
        with mpl.rc_context(STYLE):
            save(draw_ingredients(usual), given.figures / "ingredients")
            if samples:
                save(draw_samples(samples), given.figures / "samples")


def grouped(results: Iterable[Results], *names: str) -> Groups:
    """Return results grouped by the values of some names."""
    groups: Groups = {}
    for each in results:
        groups.setdefault(tuple(each[name] for name in names), []).append(each)
    return dict(sorted(groups.items()))


def rate(group: Sequence[Results], name: str) -> tuple[float, float, float]:
    """Return the success rate on a set, and its interval, in percent."""
    solved = np.stack([each["solved"][name] for each in group])
    low, high = interval(solved)
    return 100 * float(solved.mean()), 100 * low, 100 * high


def worth(group: Sequence[Results]) -> float:
    """Return a score of runs by which they are ordered."""
    return sum(rate(group, name)[0] for name in SHOWN)


def as_table(groups: Groups) -> str:
    """Return a table with a row of success rates for each group."""
    heading = ["", "", *(name.replace(", ", ",<br>") for name in SETS), "seeds", "CPU s"]
    rows = []
    for key, group in groups.items():
        cells = ["{:.0f} [{:.0f}, {:.0f}]".format(*rate(group, name)) for name in SETS]
        seconds = np.mean([each["cpu_seconds"] for each in group])
        rows.append([*map(str, key), *cells, str(len(group)), f"{seconds:.0f}"])
    return table(heading, rows, "ll" + "r" * (len(heading) - 2))


def by_seed(results: Sequence[Results]) -> str:
    """Return a table with a row for each set, and a column for each run.

    The results are of generalise.py, or of controls.py, which looks at runs of several methods.
    """
    runs = [each.get("run", each) for each in results]
    several = len({run["method"] for run in runs}) > 1
    heading = [f"{run['method']} " * several + f"seed {run['seed']}" for run in runs]
    sets = list(dict.fromkeys(name for each in results for name in each["solved"]))
    rows = [
        [name, *(f"{100 * each['solved'][name].mean():.0f}" for each in results)] for name in sets
    ]
    return table(["% solved", *heading], rows)


def draw_ingredients(groups: Groups) -> Figure:
    """Return a figure with a panel for each size, and a line for each variant."""
    sizes = sorted({config for config, _ in groups if "-" not in config})
    variants = [variant for config, variant in groups if config == sizes[-1]]
    variants.sort(key=lambda variant: worth(groups[sizes[-1], variant]))
    figure = Figure(figsize=(7.2, 0.9 + 0.27 * len(variants)), layout="constrained")
    panels = figure.subplots(1, len(sizes), sharey=True, squeeze=False)[0]
    for panel, size in zip(panels, sizes, strict=True):
        there = [variant for variant in variants if (size, variant) in groups]
        for place, (name, label) in enumerate(SHOWN.items()):
            rates = [rate(groups[size, variant], name) for variant in there]
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


def draw_samples(groups: Groups) -> Figure:
    """Return a figure of success rates by the number of labyrinths, a panel for each set."""
    figure = Figure(figsize=(7.2, 2.8), layout="constrained")
    panels = figure.subplots(1, len(SHOWN), sharey=True)
    for panel, (name, label) in zip(panels, SHOWN.items(), strict=True):
        for place, variant in enumerate(sorted({variant for variant, _ in groups}, reverse=True)):
            of_variant = {
                count: group for (name_, count), group in groups.items() if name_ == variant
            }
            mean, low, high = np.array([rate(group, name) for group in of_variant.values()]).T
            panel.fill_between(list(of_variant), low, high, color=COLOURS[place], alpha=0.2, lw=0)
            panel.plot(list(of_variant), mean, "o-", ms=4, color=COLOURS[place], label=variant)
        panel.set(xscale="log", title=label, xlabel="labyrinths trained on", ylim=(-3, 103))
        panel.grid(alpha=0.3)
    panels[0].set_ylabel("% solved")
    panels[0].legend(frameon=False)
    return figure


def save(figure: Figure, path: Path) -> None:
    """Write a figure as PNG and SVG, without the date, so that the bytes are reproducible."""
    figure.savefig(f"{path}.svg", metadata={"Date": None})
    figure.savefig(f"{path}.png", dpi=130, metadata={"Software": None})


if __name__ == "__main__":
    main()

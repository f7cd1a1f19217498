"""The figures of the report as files, SVG and PNG, to be put into papers and slides.

They are drawn by matplotlib from what the page is told, and the same data give the same bytes
where the version of matplotlib is the same.
"""

from __future__ import annotations

import io
import re
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from labyrinth_core.pictures.renderer import DEFAULT_STYLE, Colour
from labyrinth_core.world.grid import Action
from pipeline.inspection.statistics import ACTION_COLOURS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

FIGURES_FOLDER = "figures"
"""The folder of the figures, in that of the report."""

_COLUMNS = 3
_PIXELS_PER_INCH = 200
_STYLE: dict[Any, Any] = {
    "svg.hashsalt": "labyrinth-datasets",
    "font.size": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.titlesize": 9,
}
_MOST_WRITTEN = 10
"""The most rows or columns of a heat map whose shares are written on its cells."""

Split = Mapping[str, Any]


def draw_figures(
    datasets: Sequence[Mapping[str, Any]], results: Sequence[Mapping[str, Any]]
) -> dict[str, bytes] | None:
    """Return the figures by their paths in the folder of a report, None without matplotlib.

    Args:
        datasets: The data of the page on each dataset.
        results: The data of the page on each method that was evaluated.
    """
    try:
        import matplotlib as mpl
    except ImportError:
        return None
    figures = {}
    with mpl.rc_context(_STYLE):
        for dataset in datasets:
            of_dataset = [each for each in results if each["config"] == dataset["name"]]
            drawn = {name: _figure(dataset, *kind) for name, kind in _KINDS.items()}
            if of_dataset:
                drawn["results"] = _results(of_dataset)
            for name, figure in drawn.items():
                path = f"{FIGURES_FOLDER}/{dataset['name']}-{name}"
                # Without the date, which would be another in each run.
                figures[f"{path}.svg"] = _saved(figure, format="svg", metadata={"Date": None})
                figures[f"{path}.png"] = _saved(figure, format="png", dpi=_PIXELS_PER_INCH)
    return figures


def is_figure(path: str) -> bool:
    """Return whether a file in the folder of a report has the name of a figure."""
    kinds = "|".join([*_KINDS, "results"])
    return re.fullmatch(rf"{FIGURES_FOLDER}/[^/]+-({kinds})\.(svg|png)", path) is not None


def _saved(figure: Figure, **options: Any) -> bytes:
    file = io.BytesIO()
    figure.savefig(file, **options)
    return file.getvalue()


def _figure(
    dataset: Mapping[str, Any], title: str, draw: Callable[[Axes, Split, Mapping[str, Any]], None]
) -> Figure:
    """Return a figure with a panel for each split."""
    from matplotlib.figure import Figure

    splits = dataset["splits"]
    rows = -(-len(splits) // _COLUMNS)
    tall = 0.5 + 2.1 * rows
    figure = Figure(figsize=(7.2, tall))
    figure.subplots_adjust(0.08, 0.5 / tall, 0.99, 1 - 0.65 / tall, wspace=0.35, hspace=0.6)
    panels = figure.subplots(rows, _COLUMNS, squeeze=False).flat
    for panel, split in zip(panels, splits, strict=False):
        draw(panel, split, dataset)
        panel.set_title(split["name"], loc="left", fontweight="bold")
    for panel in list(panels)[len(splits) :]:
        panel.set_axis_off()
    figure.suptitle(f"{title}, {dataset['name']}", x=0.01, ha="left")
    return figure


def _distribution(key: str, unit: str) -> Callable[[Axes, Split, Mapping[str, Any]], None]:
    def draw(panel: Axes, split: Split, dataset: Mapping[str, Any]) -> None:
        from matplotlib.ticker import MaxNLocator

        values = [value for each in dataset["splits"] for value, _ in each[key]]
        most = max(
            count / each["labyrinths"] for each in dataset["splits"] for _, count in each[key]
        )
        shares = [100 * count / split["labyrinths"] for _, count in split[key]]
        panel.bar([value for value, _ in split[key]], shares, 0.9, color=_rgb(DEFAULT_STYLE.goal))
        panel.set(xlim=(min(values) - 0.6, max(values) + 0.6), ylim=(0, 105 * most))
        panel.set(xlabel=unit, ylabel="% of labyrinths")
        panel.xaxis.set_major_locator(MaxNLocator(integer=True))

    return draw


def _actions(panel: Axes, split: Split, dataset: Mapping[str, Any]) -> None:
    shares = [_shares(each["actions"]) for each in dataset["splits"]]
    names = [action.name.lower() for action in Action]
    colours = [_rgb(ACTION_COLOURS[action]) for action in Action]
    own = _shares(split["actions"])
    bars = panel.barh(names, own, color=colours)
    panel.bar_label(bars, [f"{share:.1f}%" for share in own], padding=2, fontsize=8)
    panel.set(xlim=(0, 1.25 * max(map(max, shares))), xlabel="% of actions")
    panel.invert_yaxis()


def _visits(panel: Axes, split: Split, dataset: Mapping[str, Any]) -> None:
    import numpy as np
    from matplotlib.colors import LinearSegmentedColormap
    from matplotlib.ticker import MaxNLocator

    height, width = dataset["height"], dataset["width"]
    shares = np.reshape(_shares(split["visits"]), (height, width))
    most = max(max(_shares(each["visits"])) for each in dataset["splits"])
    colours = LinearSegmentedColormap.from_list("visits", ["#f0f3f2", "#00523c"])
    panel.imshow(shares, origin="lower", cmap=colours, vmin=0, vmax=most)
    panel.set(xlabel="column", ylabel="row")
    for axis in (panel.xaxis, panel.yaxis):
        axis.set_major_locator(MaxNLocator(integer=True))
    if max(height, width) > _MOST_WRITTEN:
        return
    for (row, column), share in np.ndenumerate(shares):
        ink = "white" if share > most / 2 else "black"
        size = 32 / max(height, width)
        panel.text(column, row, f"{share:.1f}", ha="center", va="center", color=ink, fontsize=size)


def _results(methods: Sequence[Mapping[str, Any]]) -> Figure:
    """Return the success rates of methods on one dataset, a panel for each split."""
    from matplotlib.figure import Figure

    splits = list(methods[0]["splits"])
    tall = 1.1 + 0.28 * len(methods)
    figure = Figure(figsize=(2 + 1.5 * len(splits), tall), layout="constrained")
    panels = figure.subplots(1, len(splits), sharey=True, squeeze=False)[0]
    for panel, split in zip(panels, splits, strict=True):
        scores = [method["splits"][split] for method in methods]
        rates = [100 * each["sr"] for each in scores]
        bounds = [[100 * bound for bound in each["sr_interval"]] for each in scores]
        away = [
            [max(0, rate - low) for rate, (low, _) in zip(rates, bounds, strict=True)],
            [max(0, high - rate) for rate, (_, high) in zip(rates, bounds, strict=True)],
        ]
        # Between two dollar signs matplotlib would read mathematics.
        names = [method["name"].replace("$", r"\$") for method in methods]
        panel.barh(names, rates, xerr=away, color=_rgb(DEFAULT_STYLE.goal), ecolor="black")
        panel.set(xlim=(0, 105), xlabel="SR, %")
        panel.set_title(split, loc="left", fontweight="bold")
    panel.invert_yaxis()
    return figure


def _shares(counts: Sequence[int]) -> list[float]:
    """Return counts in percent of their sum."""
    total = sum(counts)
    return [100 * count / total for count in counts]


def _rgb(colour: Colour) -> tuple[float, float, float]:
    red, green, blue = colour
    return red / 255, green / 255, blue / 255


_KINDS = {
    "moves": ("Route length", _distribution("moves", "moves")),
    "actions": ("Actions", _actions),
    "visits": ("Visited cells, % of states", _visits),
    "loops": ("Loops", _distribution("loops", "passages beyond a tree")),
    "junctions": ("Branching", _distribution("junctions", "cells with three or four ways")),
}
"""Name -> title, and what draws the panel of a split."""

"""The style of the figures of docs/studies, and functions that draw several of them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from kept_results import bounds
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from labyrinth_core.pictures import DEFAULT_STYLE

INK = "#767676"
STYLE: dict[Any, Any] = {
    # Legible on white and on dark pages.
    **dict.fromkeys(
        ("text.color", "axes.labelcolor", "axes.edgecolor", "xtick.color", "ytick.color"), INK
    ),
    "legend.frameon": False,
    "savefig.transparent": True,
    "font.size": 9,
    "axes.titlesize": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
}
COLOURS = [np.array(colour) / 255 for colour in (DEFAULT_STYLE.goal, DEFAULT_STYLE.start)]


def draw_rates(
    panel: Axes, heights: Any, solved: Sequence[NDArray[np.float64]], place: int, **style: Any
) -> None:
    """Draw the success rate and the interval of each group of runs, in percent.

    Args:
        panel: The axes to draw on.
        heights: The y coordinate of each group.
        solved: For each group, 1 for each solved labyrinth, else 0, shape (seeds, labyrinths).
        place: 0 for the upper of two rates of a group, 1 for the lower.
        **style: Size of the marks, and label.
    """
    mean, low, high = 100 * np.array([bounds(each) for each in solved]).T
    errors = np.maximum([mean - low, high - mean], 0)
    heights = np.asarray(heights) + 0.12 - 0.24 * place
    panel.errorbar(mean, heights, xerr=errors, fmt="o", color=COLOURS[place], **style)
    panel.set_xlim(-3, 103)
    panel.grid(axis="x", alpha=0.3)


def heat_map(shares: NDArray[np.float64], rows: Sequence[str], columns: Sequence[str]) -> Figure:
    """Return a heat map of shares in percent, shape (rows, columns), with a number in each cell."""
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


def save(figure: Figure, path: Path) -> None:
    """Write a figure without the name of the software, so that its bytes are reproducible."""
    figure.savefig(path, dpi=130, metadata={"Software": None})

"""Write the report on environments: tables in three formats, and maps of visits."""

from __future__ import annotations

import io
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.colors import PowerNorm
from matplotlib.figure import Figure
from numpy.typing import NDArray

from environments.environment import FACTS
from environments.summaries import Discretisation
from environments.variation import Variation
from labyrinth_core.storage import File
from pipeline.machinery import table
from pipeline.results.leaderboard import as_csv

Visits = NDArray[np.int64]
Values = dict[str, Any]

_REPORTED = ("average_reward", "action_difference", "trajectory_difference", "p_value")
"""The names of the original's figures in `environments.json`."""

LIKE_THEIRS = {
    "environment": "{name}",
    "average reward": "{average_reward:,.4f} ({original[average_reward]:,.4f})",
    "actions differ": "{actions[distance]:.4f} ({original[action_difference]:.4f})",
    "trajectories differ": "{states[distance]:.4f} ({original[trajectory_difference]:.4f})",
    "p-value": "{states[p_value]:.3f} ({original[p_value]:.3f})",
    "Holm": "{states[holm]:.3f}",
    "effect size": "{states[effect]:.4f}",
}
_MORE = {
    "environment": "{name}",
    "episodes": "{seeds:,}",
    "steps": "{steps:,}",
    "reward, sd": "{reward_deviation:,.4f}",
    "least reward": "{least_reward:,.4f}",
    "actions' p-value": "{actions[p_value]:.3f}",
    "Holm": "{actions[holm]:.3f}",
    "effect size": "{actions[effect]:.4f}",
    "two episodes: actions": "{actions[two_episodes]:.4f}",
    "trajectories": "{states[two_episodes]:.4f}",
}
_FIRST = {
    "environment": "{name}",
    "Manhattan distance": "{first_states:.4f}",
    "share of the range": "{first_states_scaled:.4f}",
}
"""The columns of the three tables: headings, and formats of an environment's values."""

MAPS = "visits"
"""The file name of the pictures, without `.png` and `.svg`."""


def write_report(
    folder: Path, results: Sequence[Variation], maps: Mapping[str, tuple[Discretisation, Visits]]
) -> None:
    """Write `environments.json`, `.csv` and `.md`, and the maps of visits as PNG and SVG.

    Args:
        folder: The folder to write to.
        results: The results of all environments.
        maps: The discretisation and the visits, (2, up, across), of each environment.

    Raises:
        OSError: The folder cannot be written.
    """
    values = [
        asdict(each) | {"original": dict(zip(_REPORTED, FACTS[each.name].reported, strict=True))}
        for each in results
    ]
    texts = {
        "environments.json": json.dumps(values, indent=2) + "\n",
        "environments.csv": _csv(values),
        "environments.md": _markdown(values),
    }
    files = {name: text.encode() for name, text in texts.items()} | drawn_visits(maps)
    for name, content in files.items():
        File(folder / name).write_bytes(content)


def _csv(values: Sequence[Values]) -> str:
    """Return a CSV with a row for each environment; nested values are in columns `part.name`."""
    rows = []
    for each in values:
        row: dict[str, Any] = {}
        for key, value in each.items():
            if isinstance(value, dict):
                row |= {f"{key}.{name}": part for name, part in value.items()}
            elif not isinstance(value, tuple):
                row[key] = value
        rows.append(row)
    return as_csv(list(rows[0]), rows)


def columns_of(values: Sequence[Values], columns: Mapping[str, str]) -> str:
    """Return a table of environments as Markdown.

    Args:
        values: The values of each environment, as in `environments.json`.
        columns: Heading -> the format of its cells.
    """
    rows = [[cell.format(**each) for cell in columns.values()] for each in values]
    return table(list(columns), rows)


def _markdown(values: Sequence[Values]) -> str:
    like_theirs, more, first = (columns_of(values, each) for each in (LIKE_THEIRS, _MORE, _FIRST))
    return "\n\n".join(
        [
            "## Episodes of even and of odd seeds\n\nIn brackets, the original's table 6.",
            like_theirs,
            more,
            "## First states\n\nTwo of them, the mean of all pairs.",
            first,
            f"## Visits\n\n![Where the episodes of even and of odd seeds were]({MAPS}.png)\n",
        ]
    )


def drawn_visits(maps: Mapping[str, tuple[Discretisation, Visits]]) -> dict[str, bytes]:
    """Return the maps of visits as PNG and SVG, by file name.

    There is a column for each environment, with even seeds above odd seeds.
    """
    figure = Figure(figsize=(2.5 * len(maps), 5.2), layout="constrained")
    axes = figure.subplots(2, len(maps), squeeze=False, sharex="col", sharey="col")
    for column, (name, (discretisation, visits)) in enumerate(maps.items()):
        across, up = FACTS[name].labels
        shares = visits / visits.sum(axis=(1, 2), keepdims=True)
        # Visits vary by a factor of 100: a square root makes the rare places visible.
        norm = PowerNorm(0.5, 0, shares.max())
        for row, seeds in enumerate(("even seeds", "odd seeds")):
            panel = axes[row, column]
            visited = np.ma.masked_equal(shares[row], 0)
            edges = discretisation.across, discretisation.up
            panel.pcolormesh(*edges, visited, norm=norm, rasterized=True)
            panel.tick_params(labelsize=7)
            panel.set_ylabel(up if column else f"{seeds}\n{up}")
        axes[0, column].set_title(name, fontsize=10)
        axes[1, column].set_xlabel(across)
    with mpl.rc_context({"svg.hashsalt": MAPS}):
        png, svg = io.BytesIO(), io.BytesIO()
        figure.savefig(png, format="png", dpi=150, metadata={"Software": None})
        figure.savefig(svg, format="svg", dpi=150, metadata={"Date": None})
    return {f"{MAPS}.png": png.getvalue(), f"{MAPS}.svg": svg.getvalue()}

"""The report of the stage `environments`: tables in three formats, and maps of visits."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.data.storage import write_text
from pipeline.analysis.environments.discretisation import Discretisation
from pipeline.analysis.environments.environment import FACTS
from pipeline.analysis.environments.variation import Variation
from pipeline.config.errors import ConfigError
from pipeline.machinery.markdown import table

Visits = NDArray[np.int64]

_LIKE_THEIRS = (
    *("environment", "average reward", "actions differ", "trajectories differ"),
    *("p-value", "Holm", "effect size"),
)
_MORE = (
    *("environment", "episodes", "steps", "reward, sd", "least reward"),
    *("actions' p-value", "Holm", "effect size", "two episodes: actions", "trajectories"),
)
_FIRST = ("environment", "Manhattan distance", "share of the range")
"""The headings of the three tables."""

MAPS = "visits"
"""The name of the pictures, before `.png` and `.svg`."""


def check_can_draw() -> None:
    """Raise ConfigError if matplotlib is missing; called before hours of playing."""
    try:
        import matplotlib  # noqa: F401
    except ModuleNotFoundError as error:
        raise ConfigError(
            "stages=[environments] needs matplotlib: pip install 'labyrinth-datasets[analysis]'"
        ) from error


def write_report(
    folder: Path, results: Sequence[Variation], maps: Mapping[str, tuple[Discretisation, Visits]]
) -> None:
    """Write `environments.json`, `.csv` and `.md`, and the maps of visits as PNG and SVG.

    Args:
        folder: The folder to write to.
        results: The results of all environments.
        maps: The discretisation and the visits, (2, up, across), of each environment.
    """
    folder.mkdir(parents=True, exist_ok=True)
    values = [asdict(each) | {"original": _original(each.name)} for each in results]
    write_text(folder / "environments.json", json.dumps(values, indent=2) + "\n")
    write_text(folder / "environments.csv", _csv(values))
    write_text(folder / "environments.md", _markdown(results))
    draw_visits(folder, maps)


def _original(name: str) -> dict[str, float]:
    keys = ("average_reward", "action_difference", "trajectory_difference", "p_value")
    return dict(zip(keys, FACTS[name].reported, strict=True))


def _csv(values: Sequence[dict[str, Any]]) -> str:
    """Return a row of numbers for each environment; nested values are in columns `part.name`."""
    rows = []
    for each in values:
        row: dict[str, Any] = {}
        for key, value in each.items():
            if isinstance(value, dict):
                row |= {f"{key}.{name}": part for name, part in value.items()}
            elif not isinstance(value, tuple):
                row[key] = value
        rows.append(row)
    text = io.StringIO()
    writer = csv.DictWriter(text, rows[0], lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


def _markdown(results: Sequence[Variation]) -> str:
    like_theirs, more, first = [], [], []
    for each in results:
        reward, actions, trajectories, p_value = FACTS[each.name].reported
        like_theirs.append(
            [
                each.name,
                f"{each.average_reward:,.4f} ({reward:,.4f})",
                f"{each.actions.distance:.4f} ({actions:.4f})",
                f"{each.states.distance:.4f} ({trajectories:.4f})",
                f"{each.states.p_value:.3f} ({p_value:.3f})",
                f"{each.states.holm:.3f}",
                f"{each.states.effect:.4f}",
            ]
        )
        more.append(
            [
                each.name,
                f"{each.seeds:,}",
                f"{each.steps:,}",
                f"{each.reward_deviation:,.4f}",
                f"{each.least_reward:,.4f}",
                f"{each.actions.p_value:.3f}",
                f"{each.actions.holm:.3f}",
                f"{each.actions.effect:.4f}",
                f"{each.actions.two_episodes:.4f}",
                f"{each.states.two_episodes:.4f}",
            ]
        )
        first.append([each.name, f"{each.first_states:.4f}", f"{each.first_states_scaled:.4f}"])
    return "\n\n".join(
        [
            "## Episodes of even and of odd seeds\n\nIn brackets, the original's table 6.",
            table(_LIKE_THEIRS, like_theirs),
            table(_MORE, more),
            "## First states\n\nTwo of them, the mean of all pairs.",
            table(_FIRST, first),
            f"## Visits\n\n![Where the episodes of even and of odd seeds were]({MAPS}.png)\n",
        ]
    )


def draw_visits(folder: Path, maps: Mapping[str, tuple[Discretisation, Visits]]) -> None:
    """Draw the maps of visits: a column for each environment, even seeds above odd ones."""
    import matplotlib
    from matplotlib.colors import PowerNorm
    from matplotlib.figure import Figure

    figure = Figure(figsize=(2.5 * len(maps), 5.2), layout="constrained")
    axes = figure.subplots(2, len(maps), squeeze=False, sharex="col", sharey="col")
    for column, (name, (discretisation, visits)) in enumerate(maps.items()):
        across, up = FACTS[name].labels
        shares = visits / visits.sum(axis=(1, 2), keepdims=True)
        # Some places are visited a hundred times as often as others: a root shows the rare ones.
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
    with matplotlib.rc_context({"svg.hashsalt": MAPS}):
        figure.savefig(folder / f"{MAPS}.png", dpi=150, metadata={"Software": None})
        figure.savefig(folder / f"{MAPS}.svg", dpi=150, metadata={"Date": None})

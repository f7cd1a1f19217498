"""Make the table and figure of docs/studies/mapper.md from results of generalise.py.

    python scripts/studies/report_mapper.py docs/results/mapper --figures docs/pictures

A row for each set of labyrinths, and a column for each kind of run: files that differ in `-seed0`,
`-seed1` and so on alone. A cell has the success rate in percent, and of several seeds the lowest
and the highest in brackets. The figure has the sets that all kinds in it were tried on.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path

import matplotlib as mpl
import numpy as np
from labyrinth_sets import read_results
from matplotlib.figure import Figure
from report_ablation import STYLE, save
from report_shifts import heat_map

from pipeline.machinery.markdown import table
from pipeline.studies.results.paper import name_of

SHOWN = ("bc-cnn", "planner", "mapper")
"""The kinds of runs in the figure."""

Kinds = Mapping[str, Sequence[Mapping[str, float]]]
"""Kind of run -> the success rates in percent of each run, by set."""


def main() -> None:
    """Print the table and draw the figure."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--figures", type=Path, help="folder for the figure")
    given = parser.parse_args()
    kinds: dict[str, list[dict[str, float]]] = {}
    for path in sorted(given.folder.glob("*.json")):
        solved = read_results(path)["solved"]
        rates = {name: 100 * float(which.mean()) for name, which in solved.items()}
        kinds.setdefault(path.stem.partition("-seed")[0], []).append(rates)
    sets = max((runs[0] for runs in kinds.values()), key=len)
    rows = [[name, *(cell(runs, name) for runs in kinds.values())] for name in sets]
    print(table(["% solved", *kinds], rows))
    if given.figures is not None:
        with mpl.rc_context(STYLE):
            save(draw(kinds, sets), given.figures / "told-less")


def draw(kinds: Kinds, sets: Sequence[str]) -> Figure:
    """Return a heat map: how much of each set is solved by each kind of run that is shown."""
    shared = [name for name in sets if all(name in run for kind in SHOWN for run in kinds[kind])]
    shares = [[np.mean([run[name] for run in kinds[kind]]) for kind in SHOWN] for name in shared]
    return heat_map(np.array(shares), shared, [name_of(kind.partition("-")[0]) for kind in SHOWN])


def cell(runs: Sequence[Mapping[str, float]], name: str) -> str:
    """Return what one kind of run achieves on a set; a dash if it was not tried there."""
    rates = [rates[name] for rates in runs if name in rates]
    if not rates:
        return "-"
    spread = f" [{min(rates):.0f}, {max(rates):.0f}]" if len(rates) > 1 else ""
    return f"{np.mean(rates):.0f}{spread}"


if __name__ == "__main__":
    main()

"""What the mapper solves: the tables and a figure of mapper.md, from results of generalise.py.

A row for each set of labyrinths, and a column for each kind of run: files that differ in `-seed0`,
`-seed1` and so on alone. `report_pages.py` writes and draws them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from figures import heat_map
from kept_results import Run, read_runs, solved_in, whole
from matplotlib.figure import Figure

from pipeline.machinery.markdown import table

KINDS = {
    "mapper": "mapper",
    "planner": "planner",
    "bc-cnn": "BC",
    "without-memory": "mapper without memory",
    "without-random": "mapper without `random`",
}
"""Name of the files -> name in print."""
SHOWN = ("bc-cnn", "planner", "mapper")
"""The kinds of runs in the figure."""


def kinds_of(results: Path) -> dict[str, list[Run]]:
    """Return the runs of each kind, and those with the most sets first."""
    return {kind: read_runs(results / "mapper", f"{kind}-seed*.json") for kind in KINDS}


def sets_of(kinds: Mapping[str, Sequence[Run]]) -> list[str]:
    """Return the sets that the first seeds were tried on, then those of others."""
    return list(dict.fromkeys(name for runs in kinds.values() for name in runs[0]["solved"]))


def rates(results: Path) -> str:
    """Return a table of success rates in percent of all kinds, each seed by itself."""
    kinds = kinds_of(results)
    rows = [[name, *(cell(runs, name) for runs in kinds.values())] for name in sets_of(kinds)]
    seeds = [", ".join(str(run["run"]["seed"]) for run in runs) for runs in kinds.values()]
    return table(["% solved", *KINDS.values()], [["seeds", *seeds], *rows])


def anew(results: Path) -> str:
    """Return a table of seeds of which nothing was seen before; those not tried have no figure."""
    runs = read_runs(results / "mapper/anew")
    found: dict[str, dict[int, str]] = {}
    for run in runs:
        for name, solved in run["solved"].items():
            cells = found.setdefault(f"{name} ({len(solved)})", {})
            cells[run["run"]["seed"]] = whole(solved.mean())
    seeds = sorted({run["run"]["seed"] for run in runs})
    rows = [[name, *(cells.get(seed, "") for seed in seeds)] for name, cells in found.items()]
    return table(["% solved (labyrinths)", *(f"seed {seed}" for seed in seeds)], rows)


def cell(runs: Sequence[Run], name: str) -> str:
    """Return what the seeds of a kind solve of a set; nothing if they were not tried there."""
    return ", ".join(whole(run["solved"][name].mean()) for run in runs if name in run["solved"])


def draw(results: Path) -> Figure:
    """Return a heat map: how much of each set is solved by each kind of run that is shown."""
    kinds = kinds_of(results)
    shared = [
        name
        for name in sets_of(kinds)
        if all(name in run["solved"] for kind in SHOWN for run in kinds[kind])
    ]
    shares = [[solved_in(kinds[kind], name).mean() for kind in SHOWN] for name in shared]
    return heat_map(100 * np.array(shares), shared, [KINDS[kind] for kind in SHOWN])

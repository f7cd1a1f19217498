"""Tables and figures for mapper.md: success rates of the mapper, from an archived study.

There is a row for each set of labyrinths, and a column or two for each kind of run, whose files
differ only in `-seed0`, `-seed1` and so on. `report_pages.py` writes and draws them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import product
from statistics import median

import numpy as np
from figures import COLOURS, INK, heat_map
from kept_results import RESULTS, Run, read_run, read_runs, solved_in, whole
from matplotlib.figure import Figure

from pipeline.machinery import table

KINDS = {
    "mapper": "mapper",
    "planner": "planner",
    "bc-cnn": "BC",
    "slots-bc": "BC on slots",
    "slots-vin": "VIN on slots",
    "without-memory": "mapper without memory",
    "without-random": "mapper without `random`",
}
"""Name of the files -> name in print."""
ON_SLOTS = {
    "": "",
    "-plain": ", pictures not varied",
    "-explore": ", outcomes predicted",
}
"""Suffix of a kind of runs on slots -> its difference, in print."""
SHOWN = ("bc-cnn", "planner", "mapper")
"""The kinds of runs in the figure."""


def kinds_of() -> dict[str, list[Run]]:
    """Return the runs of each kind."""
    return {kind: read_runs("mapper", f"{kind}-seed*.json") for kind in KINDS}


def sets_of(kinds: Mapping[str, Sequence[Run]]) -> list[str]:
    """Return the sets on which the first seed of any kind was evaluated, without duplicates."""
    return list(dict.fromkeys(name for runs in kinds.values() for name in runs[0]["solved"]))


def rates() -> str:
    """Return a table of success rates in percent; for several seeds, the median and the worst."""
    kinds = kinds_of()
    columns = [column for kind, runs in kinds.items() for column in columns_of(kind, runs)]
    heads = ["% solved", *(head for head, _, _ in columns)]
    rows = [
        [name, *(shown(runs, name, middle) for _, runs, middle in columns)]
        for name in sets_of(kinds)
    ]
    return table(heads, rows)


Column = tuple[str, Sequence[Run], Callable[[Sequence[float]], float]]
"""The heading, the runs, and the function that summarises their success rates."""


def columns_of(kind: str, runs: Sequence[Run]) -> list[Column]:
    """Return a kind's columns: one for a single seed, else the median and the worst."""
    if len(runs) == 1:
        return [(KINDS[kind], runs, max)]
    seeds = f"{KINDS[kind]}, {len(runs)} seeds"
    return [(f"{seeds}: median", runs, median), ("worst", runs, min)]


def shown(
    runs: Sequence[Run], name: str, middle: Callable[[Sequence[float]], float] = median
) -> str:
    """Return a summary of the success rates on a set; empty if no run was evaluated on it."""
    shares = shares_of(runs, name)
    return f"{100 * middle(shares):.3g}" if shares else ""


def shares_of(runs: Sequence[Run], name: str) -> list[float]:
    """Return the success rate on a set of each run that was evaluated on it."""
    return [float(run["solved"][name].mean()) for run in runs if name in run["solved"]]


def on_slots() -> str:
    """Return a table of the archived runs on slots, in percent: variants with seed 0."""
    names = ["test", "test, walls of a quarter", "test, moved by 12 pixels", "test, new ends"]
    names.append("fresh 10x10")
    rows = []
    for kind, (end, differs) in product(("slots-bc", "slots-vin"), ON_SLOTS.items()):
        path = RESULTS / f"mapper/{kind}{end}-seed0.json"
        if path.exists():
            run = read_run(path)
            shares = [
                run["selected"]["validation_sr"],
                *(run["solved"][name].mean() for name in names),
            ]
            epochs = f"{run['selected']['epoch']} of {run['epochs']}"
            rows.append([f"{KINDS[kind]}{differs}", epochs, *map(whole, shares)])
    return table(["% solved, seed 0", "epoch selected", "validation", *names], rows)


def by_size() -> dict[int, list[Run]]:
    """Return the runs that were evaluated on each size, in ascending order."""
    runs = read_runs("mapper/sizes")
    sides = {int(name.split("x")[1]) for run in runs for name in run["solved"]}
    return {side: [run for run in runs if set_of(side) in run["solved"]] for side in sorted(sides)}


def set_of(side: int) -> str:
    """Return the name of the set of fresh labyrinths of a size."""
    return f"fresh {side}x{side}"


def sizes() -> str:
    """Return a table of the seeds' success rates on fresh labyrinths of each size, in percent."""
    rows = [
        [
            f"{side}x{side}",
            str(len(runs[0]["solved"][set_of(side)])),
            shown(runs, set_of(side)),
            shown(runs, set_of(side), min),
        ]
        for side, runs in by_size().items()
    ]
    return table(["size", "labyrinths a seed", "% solved: median", "worst"], rows)


def draw_sizes() -> Figure:
    """Return a figure of the success rate by size: the median and the worst over all seeds."""
    found = {side: np.array(shares_of(runs, set_of(side))) for side, runs in by_size().items()}
    seeds = len(read_runs("mapper/sizes"))
    figure = Figure(figsize=(6.4, 3.0), layout="constrained")
    panel = figure.subplots()
    middle, low = (
        [100 * summary(each) for each in found.values()] for summary in (np.median, np.min)
    )
    panel.fill_between(list(found), low, middle, color=COLOURS[0], alpha=0.25, lw=0)
    panel.plot(
        list(found), middle, "o-", ms=4, color=COLOURS[0], label=f"mapper, median of {seeds}"
    )
    panel.plot(list(found), low, "o:", ms=3, color=COLOURS[0], label="mapper, worst seed")
    for kind, mark in (("planner", "s"), ("bc-cnn", "v")):
        (run,) = kinds_of()[kind]
        sides = [side for side in (10, 25) if set_of(side) in run["solved"]]
        shares = [100 * run["solved"][set_of(side)].mean() for side in sides]
        panel.plot(
            sides, shares, mark, ms=6, mfc="none", color=INK, label=f"{KINDS[kind]}, one seed"
        )
    panel.axvline(5, color=INK, lw=0.8, ls="--")
    panel.annotate("trained at 5x5", (5, 50), (5, 0), textcoords="offset points", rotation=90)
    panel.set(xlim=(0, max(found) + 1), ylim=(-3, 103), ylabel="% solved")
    panel.set_xlabel("rows and columns of labyrinths with structures that no seed was trained on")
    panel.grid(alpha=0.3)
    panel.legend(loc="center right")
    return figure


def draw() -> Figure:
    """Return a heat map of the success rates by set, for the kinds of runs in `SHOWN`."""
    kinds = kinds_of()
    shared = [
        name
        for name in sets_of(kinds)
        if all(name in run["solved"] for kind in SHOWN for run in kinds[kind])
    ]
    shares = [[solved_in(kinds[kind], name).mean() for kind in SHOWN] for name in shared]
    return heat_map(100 * np.array(shares), shared, [KINDS[kind] for kind in SHOWN])

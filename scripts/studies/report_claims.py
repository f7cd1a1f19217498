"""What the methods can be said to do, and what that cost: tables and a figure of results.md.

On the 1,000 labyrinths of test in `docs/results/thousand`: success, where train demonstrates an
optimal route and where it does not, in all and in those alike in length and in the number of
optimal routes; which methods differ by more than chance. Then the hours of all runs, by method.
Intervals: 95%, over labyrinths and seeds. `report_pages.py` writes and draws them.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from math import fsum
from pathlib import Path
from typing import Any

import numpy as np
from figures import draw_rates
from kept_results import RESULTS, Groups, by_method, percent, rate, read_runs, solved_in, whole
from matplotlib.figure import Figure
from numpy.typing import NDArray
from run_queue import HOURS, LONGEST, SCALING, missing_in

from labyrinth_core.evaluation.baselines import REFERENCES
from labyrinth_core.evaluation.scores import interval
from labyrinth_core.storage import File
from pipeline.machinery import table
from pipeline.results.leaderboard import IN_PRINT, name_of
from pipeline.results.leaderboard import RANKED_BY as SPLIT
from pipeline.results.tables import conclusion, differences_of, interquartile_mean

ABOUT_PAIRS = f"""\
On {SPLIT}, the mean SR over seeds of the row's method minus that of the column's, in points, and in
parentheses the p-value by exchanging runs, with Holm's correction over all pairs:"""

PARTS = {"known": "train demonstrates an optimal route", "new": "train demonstrates none"}
"""Part of the labyrinths -> what it is."""

Parts = Mapping[str, NDArray[np.bool_]]
"""Part of the labyrinths -> whether each labyrinth is in it, shape (L,)."""


def routes_of(labyrinths: int, split: str) -> dict[str, tuple[int, int]]:
    """Return the moves of a shortest route and the number of such routes, by labyrinth.

    Args:
        labyrinths: How many train has.
        split: The split.
    """
    found: dict[str, tuple[int, int]] = File(RESULTS / f"routes/{labyrinths}.json").read_json()[
        split
    ]
    return found


def moves_and_routes(labyrinths: int, groups: Groups, split: str) -> Any:
    """Return the same for the labyrinths that runs were evaluated on, shape (2, L)."""
    found = routes_of(labyrinths, split)
    first = next(iter(groups.values()))[0]
    return np.array([found[each] for each in first["splits"][split]["labyrinth_ids"]]).T


def thousand() -> Groups:
    """Return the runs on a thousand labyrinths."""
    return by_method(read_runs("thousand/runs/5x5"))


def six(groups: Groups) -> list[Any]:
    """Return the runs of the paper's six methods."""
    return [run for name in IN_PRINT.values() for run in groups[name]]


def rates() -> str:
    """Return a table with a row for each method, and for each reference."""
    groups = thousand()
    heading = ["", "seeds", "SR", "interquartile mean", "SPL"]
    rows = []
    for name, runs in groups.items():
        solved = solved_in(runs, SPLIT)
        middle = whole(interquartile_mean(solved.mean(axis=1)))
        spl = float(np.mean([each["splits"][SPLIT]["spl"] for each in runs]))
        rows.append([name, str(len(runs)), rate(solved), middle, whole(spl)])
    references = next(iter(groups.values()))[0]["baselines"]
    for name in (*REFERENCES, "random", "oracle"):
        sr, spl = (whole(references[name][SPLIT][figure]) for figure in ("sr", "spl"))
        rows.append([f"*{name.replace('_', ' ')}*", "", sr, "", spl])
    return table(heading, rows)


def parts_of(groups: Groups) -> dict[str, Parts]:
    """Return the parts of test: of all labyrinths, of those alike in length, and in routes."""
    marks = next(iter(groups.values()))[0]["splits"][SPLIT]["known_route"]
    known = np.array([mark == "1" for mark in marks])
    moves, routes = moves_and_routes(1000, groups, SPLIT)
    usual = int(np.bincount(moves).argmax())
    alike = {
        "all": np.ones_like(known),
        f"{usual} moves": moves == usual,
        f"{usual} moves, one optimal route": (moves == usual) & (routes == 1),
    }
    return {name: {"known": known & like, "new": ~known & like} for name, like in alike.items()}


def known_routes() -> str:
    """Return a table of what is known and new: labyrinths, optimal routes, the mean of six."""
    groups = thousand()
    _, routes = moves_and_routes(1000, groups, SPLIT)
    solved, rows = solved_in(six(groups), SPLIT), []
    for name, parts in parts_of(groups).items():
        known, new = parts.values()
        counted = [f"{part.sum()}, {routes[part].mean():.2f}" for part in (known, new)]
        rows.append([name, *counted, *_compared(solved, parts)])
    heading = ["shortest routes", "known: labyrinths, optimal routes", "new: the same"]
    return table([*heading, "six methods: known", "new", "difference"], rows)


def by_route() -> str:
    """Return a table of each method's success with known and new routes, and the difference."""
    groups = thousand()
    parts = parts_of(groups)
    rows = []
    for name, runs in groups.items():
        cells = (_compared(solved_in(runs, SPLIT), each) for each in parts.values())
        rows.append([name, *(f"{known} / {new}: {by}" for known, new, by in cells)])
    return table(["known / new: difference", *parts], rows)


def _compared(solved: NDArray[np.float64], parts: Parts) -> Iterator[str]:
    """Yield the success rate in each of two parts, and by how much the first is higher."""
    first, second = (solved[:, which] for which in parts.values())
    yield from (whole(each.mean()) for each in (first, second))
    yield percent(first.mean() - second.mean(), *interval(first, second))


def pairs() -> str:
    """Return a table that compares each pair of methods, and which differ by more than chance."""
    groups = thousand().items()
    rates = {name: solved_in(runs, SPLIT).mean(axis=1) for name, runs in groups}
    found = differences_of(rates)

    def difference(one: str, other: str) -> str:
        if (one, other) not in found:
            return ""
        points, p = 100 * (rates[one].mean() - rates[other].mean()), found[one, other]
        return f"{round(points)} ({'<0.01' if p < 0.005 else f'{p:.2f}'})"

    *above, _ = rates
    _, *beside = rates
    rows = [[one, *(difference(one, other) for other in beside)] for one in above]
    spread = (
        f"{name} {len(each)} ({whole(each.min())} to {whole(each.max())}%)"
        for name, each in rates.items()
    )
    seeds = f"Seeds, and what the worst and the best of them solve: {', '.join(spread)}."
    return "\n\n".join([ABOUT_PAIRS, table(["", *beside], rows), conclusion(rates), seeds])


def new_routes() -> str:
    """Return a table of success on test and on test_new_routes, as it is and alike in routes.

    Labyrinths of test count as often as those of `test_new_routes` have as many moves and optimal
    routes; of these, the ones that test has none of are left out.
    """
    groups = by_method(read_runs("shifts/runs/5x5"))
    of_test, of_new = (
        [tuple(each) for each in moves_and_routes(100, groups, split).T.tolist()]
        for split in (SPLIT, "test_new_routes")
    )
    shared = np.array([each in of_test for each in of_new])
    weights = np.array([of_new.count(each) / of_test.count(each) for each in of_test])
    rows = []
    for name, runs in groups.items():
        test, new = (solved_in(runs, split) for split in (SPLIT, "test_new_routes"))
        alike = float((test * weights).mean(axis=0).sum() / weights.sum())
        rows.append([name, *map(whole, (test.mean(), new.mean(), alike, new[:, shared].mean()))])
    matched = f"alike in moves and optimal routes ({shared.sum()} of {len(shared)})"
    return table(["", "test", "`test_new_routes`", f"{matched}: test", "`test_new_routes`"], rows)


def matching() -> str:
    """Return a table of lengths and numbers of routes of splits, by the labyrinths of train."""
    rows = []
    for count in (100, 200):
        splits = ("train", SPLIT, "test_new_routes", "longer")
        train, test, new, longer = (
            np.array([*routes_of(count, split).values()]) for split in splits
        )
        cells = [
            f"{(each[:, 0] == 8).sum()}, {each[:, 0].mean():.1f}, {each[:, 1].mean():.2f}"
            for each in (test, new)
        ]
        rows.append([str(count), *cells, str(train[:, 0].max()), f"{longer[:, 0].mean():.1f}"])
    heading = ["labyrinths", "test: of eight moves, moves, optimal routes"]
    heading += ["`test_new_routes`: the same", "longest route of train", "`longer`: moves"]
    return table(heading, rows)


def draw() -> Figure:
    """Return a figure of success with and without a route to remember, a row for each method."""
    groups = thousand()
    parts = parts_of(groups)
    figure = Figure(figsize=(7.2, 1.0 + 0.3 * len(groups)), layout="constrained")
    panels = figure.subplots(1, len(parts), sharey=True)
    rows = np.arange(len(groups))[::-1]
    for panel, (alike, each) in zip(panels, parts.items(), strict=True):
        for place, (name, which) in enumerate(each.items()):
            solved = [solved_in(runs, SPLIT)[:, which] for runs in groups.values()]
            draw_rates(panel, rows, solved, place, ms=5, label=PARTS[name])
        panel.set(xlabel=f"% solved of {SPLIT}, 5x5", title=alike)
    panels[0].set_yticks(rows, list(groups))
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper center", ncols=2)
    return figure


def costs() -> str:
    """Return a table of runs and core-hours by method, of all runs that are kept in a folder."""
    found: dict[str, dict[tuple[Any, ...], float]] = {}
    logged = _logged()
    for path, content in _kept():
        if "variant" in content:  # Of the ablation (docs/results/ARCHIVE.md).
            method, seconds = content["variant"], content["cpu_seconds"]
            method = "BC" if method.startswith("bc") else "planner"
            key = tuple(str(content[name]) for name in ("config", "variant", "labyrinths", "seed"))
        else:
            run = content["run"]
            seconds = content.get("seconds_of_training", run.get("training", {}).get("seconds"))
            method = name_of(run["method"])
            if run["method"].startswith("slots-"):
                method = "BC and VIN on slots"
            elif run.get("training", {}).get("computed", {}).get("device") == "cuda":
                method = "ResNet-18, on a GPU"
            key = (run["fingerprint"], run["seed"], seconds)  # Evaluated on several datasets.
            seconds = logged.get(path.relative_to(RESULTS).as_posix(), seconds)
        found.setdefault(method, {})[key] = seconds
    rows = [
        [method, str(len(runs)), f"{fsum(runs.values()) / 3600:.1f}"]
        for method, runs in found.items()
    ]
    runs = str(sum(len(each) for each in found.values()))
    hours = fsum(seconds for each in found.values() for seconds in each.values()) / 3600
    return table(["method", "runs", "hours"], [*rows, ["all", runs, f"{hours:.1f}"]])


def missing() -> str:
    """Return a table of the runs of the queue that are not kept, with their hours.

    Those of scaling.md are in a table there.
    """
    missed = [each for each in missing_in(RESULTS) if not each.kept.startswith(SCALING)]
    left = [each for each in missed if each.hours <= LONGEST]
    longer = [each for each in missed if each.hours > LONGEST]
    rows = [[f"`{each.kept}`", "1", f"{each.hours}"] for each in longer]
    for folder in sorted({each.folder for each in left}):
        hours = [each.hours for each in left if each.folder == folder]
        rows.append([f"others in `{folder}`", str(len(hours)), f"{fsum(hours):.1f}"])
    return table(["not run", "runs", "hours"], rows)


def _logged() -> dict[str, float]:
    """Return the seconds of processor time of runs of the queue, by their places."""
    seconds: dict[str, float] = {}
    log = RESULTS / HOURS
    for line in log.read_text(encoding="utf-8").splitlines() if log.exists() else ():
        place, hours, _ = line.split(",")
        seconds[place] = seconds.get(place, 0) + 3600 * float(hours)
    return seconds


def _kept() -> Iterator[tuple[Path, dict[str, Any]]]:
    """Yield each file that describes a run with the time that it took, and its content."""
    for path in sorted(RESULTS.rglob("*-seed*.json")):
        content = File(path).read_json()
        if content.get("kind") or content.keys() & {"cpu_seconds", "seconds_of_training"}:
            yield path, content

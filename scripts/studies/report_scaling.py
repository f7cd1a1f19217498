"""Tables and the figure of scaling.md: success against the number of training labyrinths.

The runs are planned by `run_queue.scaling`; `report_pages.py` writes the tables. A policy is
evaluated on a thousand labyrinths of test. Its `train`, `s0` and `s0_and_g` are those of the first
thousand that it learnt from; of a policy that learnt from fewer, of these alone.
"""

from __future__ import annotations

from itertools import product
from math import fsum
from typing import NamedTuple

import numpy as np
from figures import COLOURS, INK
from kept_results import RESULTS, Run, bounds, rate, read_run, solved_in, whole
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray
from run_queue import GOALS, MANY, SCALING, STEPS, missing_in, scaling

from labyrinth_core.evaluation import RunName
from pipeline.machinery import table
from pipeline.results.leaderboard import name_of

RESAMPLES = 2_000

LEARNT = 0.1
"""Below this loss on train there is nothing left to learn from these labyrinths."""

SPLITS = ("train", "test", "s0", "s0_and_g")

Floats = NDArray[np.float64]
Curve = dict[int | str, list[Run]]
"""The number of training labyrinths, or `RunName.FRESH`, -> the runs, one for each seed."""


def curve(goals: str, steps: int, method: str = "bc") -> Curve:
    """Return the kept runs of a method with the same gradient steps, by labyrinths."""
    runs = [
        read_run(path)
        for path in sorted((RESULTS / SCALING / f"{goals}-{steps}/runs/5x5").glob(f"{method}-*"))
    ]
    learnt = [run["run"]["train_labyrinths"] for run in runs]
    order = sorted(set(learnt), key=lambda each: (each == RunName.FRESH, each))
    return {
        each: [run for run, of in zip(runs, learnt, strict=True) if of == each] for each in order
    }


def longest(goals: str) -> tuple[int, Curve]:
    """Return the largest number of steps with which BC has most points, and its curve."""
    curves = {steps: curve(goals, steps) for steps in STEPS}
    steps = max(curves, key=lambda each: (len(curves[each]), each))
    return steps, curves[steps]


def shown(labyrinths: int | str) -> str:
    """Return a number of labyrinths in print."""
    return "without end" if labyrinths == RunName.FRESH else f"{labyrinths:,}"


def solved(runs: list[Run], split: str) -> Floats:
    """Return 1 for each solved labyrinth of a split that the runs learnt from, else 0."""
    learnt = runs[0]["run"]["train_labyrinths"]
    outcomes = solved_in(runs, split)
    return outcomes if split == "test" or learnt == RunName.FRESH else outcomes[:, :learnt]


def known(run: Run) -> NDArray[np.bool_]:
    """Return for which test labyrinths train demonstrates an optimal route."""
    return np.array([mark == "1" for mark in run["splits"]["test"]["known_route"]])


def rates() -> str:
    """Return a table by method and number of labyrinths, with known and new routes apart."""
    rows = []
    for method, goals, steps in product(("bc", "dagger", "iupe", "gail"), GOALS, STEPS):
        for labyrinths, runs in curve(goals, steps, method).items():
            of_test, there = solved(runs, "test"), known(runs[0])
            spl = np.mean([run["splits"]["test"]["spl"] for run in runs])
            memory = runs[0]["baselines"]["route_memory"]["test"]["sr"]
            rows.append(
                [
                    name_of(method),
                    goals,
                    f"{steps:,}",
                    shown(labyrinths),
                    str(len(runs)),
                    whole(solved(runs, "train").mean()),
                    rate(of_test),
                    whole(float(spl)),
                    rate(of_test[:, there]) if there.any() else "",
                    rate(of_test[:, ~there]) if not there.all() else "",
                    whole(memory),
                ]
            )
    heading = ["method", "goals", "steps", "labyrinths", "seeds", "train", "test", "SPL"]
    return table([*heading, "known routes", "new routes", "*memory*"], rows, "llrrrrrrrrr")


def new_ends() -> str:
    """Return a table of BC with new starts, and with new starts and goals."""
    rows = [
        [goals, f"{steps:,}", shown(labyrinths), *(rate(solved(runs, each)) for each in SPLITS[2:])]
        for goals in GOALS
        for steps in STEPS
        for labyrinths, runs in curve(goals, steps).items()
    ]
    return table(["goals", "steps", "labyrinths", "`s0`", "`s0_and_g`"], rows, "lrrrr")


class Law(NamedTuple):
    """The law error = c N^-b, fitted to the error on test after N labyrinths."""

    exponent: float
    """b."""
    factor: float
    """c."""
    low: float
    high: float
    """The 95% interval of the exponent, by resampling labyrinths of test."""
    farthest: float
    """The largest distance of a point from the line, in standard errors of the point."""

    @property
    def fits(self) -> bool:
        """Whether no point is three standard errors away from the line."""
        return self.farthest < 3


def law(points: Curve) -> Law | None:
    """Return the fitted law; None if fewer than four numbers of labyrinths are kept."""
    counts = [count for count in points if isinstance(count, int)]
    if len(counts) < 4:
        return None
    of_test = [solved(points[count], "test").mean(axis=0) for count in counts]
    failed = 1 - np.stack(of_test)
    logs = np.log(np.array(counts, np.float64))
    rng = np.random.default_rng(0)
    drawn = rng.integers(failed.shape[1], size=(RESAMPLES, failed.shape[1]))
    errors = np.maximum(failed[:, drawn].mean(axis=2), 0.5 / failed.shape[1])
    spread = np.log(errors).std(axis=1)
    slopes = [np.polyfit(logs, np.log(each), 1, w=1 / spread)[0] for each in errors.T]
    slope, level = np.polyfit(logs, np.log(failed.mean(axis=1)), 1, w=1 / spread)
    away = np.abs(np.log(failed.mean(axis=1)) - slope * logs - level) / spread
    low, high = np.quantile(slopes, [0.025, 0.975])
    return Law(-slope, float(np.exp(level)), -high, -low, float(away.max()))


def laws() -> str:
    """Return a table of the fitted exponents."""
    rows = []
    for goals in GOALS:
        steps, points = longest(goals)
        if not points:
            continue
        found = law(points)
        cells = ["fewer than four points", "", ""]
        if found is not None:
            cells = [
                f"{found.exponent:.2f} [{found.low:.2f}, {found.high:.2f}]",
                f"{found.farthest:.1f}",
                "yes" if found.fits else "no",
            ]
        rows.append([goals, f"{steps:,}", *cells])
    heading = ["goals", "steps", "exponent b", "largest distance", "fits"]
    return table(heading, rows, "lrrrl")


def limits() -> str:
    """Return a table of what is left of the loss on train, which says what limits a point."""
    rows = []
    for goals in GOALS:
        for steps in STEPS:
            for labyrinths, runs in curve(goals, steps).items():
                made = [run["run"]["training"] for run in runs]
                losses = [each["selected"]["loss"] for each in made]
                rows.append(
                    [
                        goals,
                        f"{steps:,}",
                        shown(labyrinths),
                        ", ".join(
                            f"{each['selected']['epoch']} of {each['epochs']}" for each in made
                        ),
                        ", ".join(f"{loss:.3f}" for loss in losses),
                        ", ".join(whole(each["selected"]["validation_sr"]) for each in made),
                        "labyrinths" if max(losses) < LEARNT else "steps",
                        f"{fsum(each['seconds'] for each in made) / 3600:.2f}",
                    ]
                )
    heading = ["goals", "steps", "labyrinths", "epoch kept", "loss", "validation", "limit"]
    return table([*heading, "hours"], rows, "lrrrrrlr")


def missing() -> str:
    """Return a table of the planned runs that are not kept, with their hours."""
    left = {each.kept for each in missing_in(RESULTS)}
    groups: dict[tuple[str, str], list[float]] = {}
    for each in scaling():
        if each.kept in left:
            folder, name = each.kept.split("/")[1], each.kept.split("/")[-1]
            key = folder, name_of(name.split("-")[0])
            groups.setdefault(key, []).append(each.hours)
    rows = [
        [method, *folder.rsplit("-", 1), str(len(hours)), f"{fsum(hours):.1f}"]
        for (folder, method), hours in groups.items()
    ]
    total = fsum(fsum(hours) for hours in groups.values())
    rows.append(["all", "", "", str(sum(map(len, groups.values()))), f"{total:.1f}"])
    return table(["not run", "goals", "steps", "runs", "hours"], rows, "llrrr")


def draw() -> Figure:
    """Return a figure of success on test, and with new starts and goals, by labyrinths."""
    figure = Figure(figsize=(7.4, 3.2), layout="constrained")
    left, right = figure.subplots(1, 2, sharey=True)
    steps, points = longest("fixed")
    ends = MANY * 4
    places = {count: ends if count == RunName.FRESH else count for count in points}
    of_test = {count: solved(runs, "test") for count, runs in points.items()}
    there = {count: known(runs[0]) for count, runs in points.items()}
    draw_line(left, places, of_test, COLOURS[0], "all of test", "o")
    for label, marker, style, is_known in (
        ("known routes", "^", "--", True),
        ("new routes", "v", ":", False),
    ):
        some = {count: of_test[count][:, there[count] == is_known] for count in points}
        some = {count: each for count, each in some.items() if each.size}
        draw_line(left, places, some, INK, label, marker, style)
    memory = [100 * runs[0]["baselines"]["route_memory"]["test"]["sr"] for runs in points.values()]
    left.plot(
        [*places.values()], memory, "x-", color=INK, lw=1, alpha=0.6, label="memory of routes"
    )
    found = law(points)
    if found is not None and found.fits:
        counts = np.geomspace(100, 1e5)
        line = 100 * (1 - found.factor * counts**-found.exponent)
        left.plot(counts, line, "--", color=COLOURS[1], lw=1, label="law, extrapolated")
    planner = read_run(RESULTS / "thousand/runs/5x5/planner-seed0.json")
    level = 100 * planner["solved"]["test"].mean()
    left.axhline(level, color=COLOURS[1], lw=1, label="planner from 100")
    left.set_title(f"test, BC with {steps:,} gradient steps")
    for place, goals in enumerate(GOALS):
        steps, points = longest(goals)
        places = {count: ends if count == RunName.FRESH else count for count in points}
        for split, style, marker in (("s0", ":", "s"), ("s0_and_g", "-", "o")):
            some = {count: solved(runs, split) for count, runs in points.items()}
            draw_line(right, places, some, COLOURS[place], f"{split}, goals={goals}", marker, style)
    right.set_title("new starts (s0), and new goals too")
    for panel in (left, right):
        panel.set(xscale="log", xlabel="labyrinths trained on", xlim=(70, 2 * ends), ylim=(-3, 103))
        panel.set_xticks([100, 1_000, MANY, ends], ["100", "1,000", "10,000", "without\nend"])
        panel.minorticks_off()
        panel.grid(alpha=0.3)
        panel.legend(frameon=False, fontsize=7)
    left.set_ylabel("% solved")
    return figure


def draw_line(
    panel: Axes,
    places: dict[int | str, int],
    of_points: dict[int | str, Floats],
    colour: object,
    label: str,
    marker: str,
    style: str = "-",
) -> None:
    """Draw success rates with their intervals against the places of the points."""
    if not of_points:
        return
    mean, low, high = 100 * np.array([bounds(each) for each in of_points.values()]).T
    errors = np.maximum([mean - low, high - mean], 0)
    where = [places[count] for count in of_points]
    panel.errorbar(
        where, mean, yerr=errors, fmt=marker + style, ms=4, lw=1, color=colour, label=label
    )

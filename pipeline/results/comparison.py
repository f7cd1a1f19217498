"""Test whether methods differ significantly, and report it in Markdown.

The unit is a training run: each seed gives another policy, and the question is whether a method is
better over seeds, on these labyrinths. The test permutes runs between two methods. A bootstrap over
a few seeds would too often find a difference between equal methods, because few seeds show little
of the variance. The interquartile mean is that of Agarwal et al. (2021), "Deep reinforcement
learning at the edge of the statistical precipice", with a percentile bootstrap over runs.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from itertools import combinations
from math import comb
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.evaluation.intervals import CONFIDENCE
from labyrinth_core.evaluation.results import Results
from pipeline.inspection.shift import holm
from pipeline.machinery.markdown import count, plain, table
from pipeline.results.figures import MethodRuns, solved_in
from pipeline.results.paper import name_of

SPLIT = "test"

ABOUT_PAIRS = f"""\
On {SPLIT}, the mean SR over seeds of the row's method minus that of the column's, in points, and in
parentheses the p-value by exchanging runs, with Holm's correction over all pairs:"""

ABOUT_SIZES = f"""\
Interquartile mean of SR on {SPLIT} over sizes and seeds, with an interval over seeds. It says
nothing about other labyrinths, so it does not rank methods.
"""

RESAMPLES = 10_000
"""The number of resamples of an interval, and the maximum number of divisions in a test."""

LEVEL = 1 - CONFIDENCE
"""The significance level: a difference counts if its p-value is at most this."""

_ROUNDING = 1e-12
"""The rounding error allowed between equal differences of means."""


class Estimate(NamedTuple):
    """A value and its confidence interval."""

    value: float
    low: float
    high: float


def interquartile_mean(tasks: Sequence[NDArray[np.float64]]) -> Estimate:
    """Return the mean of the middle half of all scores, with its interval.

    The lowest and the highest quarter of the scores, rounded down, are left out. Runs are resampled
    within each task (section 4.3 of the paper).

    Args:
        tasks: For each task, the scores of its runs, shape (runs,).
    """
    rng = np.random.default_rng(0)
    drawn = [each[rng.integers(len(each), size=(RESAMPLES, len(each)))] for each in tasks]
    (value,) = _middle(np.concatenate(tasks)[None]).tolist()
    tail = LEVEL / 2
    low, high = np.quantile(_middle(np.concatenate(drawn, axis=1)), [tail, 1 - tail])
    return Estimate(value, float(low), float(high))


def _middle(scores: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the mean of the middle half of each row."""
    cut = scores.shape[1] // 4
    means: NDArray[np.float64] = np.sort(scores)[:, cut : scores.shape[1] - cut].mean(axis=1)
    return means


def exchange_test(mine: NDArray[np.float64], others: NDArray[np.float64]) -> float:
    """Return the two-sided p-value of a permutation test for the difference of two means.

    It is the share of all divisions of the runs into groups of these sizes whose means differ at
    least as much; if there are more than `RESAMPLES` divisions, the share in that many random ones.
    The rate of false positives is at most the level, for any number of runs and any distribution
    (Fisher 1935, "The design of experiments"; Phipson and Smyth 2010).

    Args:
        mine: The scores of one method's runs, shape (runs,).
        others: The scores of the other method's runs, shape (runs,).
    """
    scores, chosen = np.concatenate([mine, others]), _divisions(len(mine), len(others))
    sums = chosen @ scores
    differences = np.abs(sums / len(mine) - (scores.sum() - sums) / len(others))
    return float((differences >= differences[0] - _ROUNDING).mean())


@cache
def _divisions(first: int, second: int) -> NDArray[np.float64]:
    """Return the divisions of runs into two groups, shape (divisions, runs), the actual one first.

    A 1 puts a run into the first group, a 0 into the second.
    """
    runs = first + second
    if comb(runs, first) <= RESAMPLES:
        chosen = np.zeros((comb(runs, first), runs))
        for row, group in zip(chosen, combinations(range(runs), first), strict=True):
            row[list(group)] = 1
        return chosen
    actual = (np.arange(runs) < first).astype(np.float64)
    drawn = np.random.default_rng(0).permuted(np.tile(actual, (RESAMPLES - 1, 1)), axis=1)
    return np.concatenate([actual[None], drawn])


def differences_of(scores: Mapping[str, NDArray[np.float64]]) -> dict[tuple[str, str], float]:
    """Return the p-value of each pair of methods, corrected for all pairs (Holm 1979).

    Args:
        scores: Method -> the scores of its runs, shape (runs,).
    """
    found = {
        (one, other): exchange_test(scores[one], scores[other])
        for one, other in combinations(scores, 2)
    }
    return dict(zip(found, holm([*found.values()]).tolist(), strict=True))


def rates_of(methods: Sequence[MethodRuns]) -> dict[str, NDArray[np.float64]]:
    """Return the success rates of each method's runs, for methods of one setup."""
    return {name_of(each.method): solved_in(each.runs, SPLIT).mean(axis=1) for each in methods}


def pairs_of_methods(rates: Mapping[str, NDArray[np.float64]]) -> Iterator[str]:
    """Yield a table that compares each pair of methods, and its conclusion; nothing for one method.

    Args:
        rates: Method -> the success rates of its runs, shape (runs,).
    """
    if len(rates) < 2:
        return
    found = differences_of(rates)
    yield ABOUT_PAIRS
    *above, _ = rates
    _, *beside = rates
    rows = [[one, *(_difference(found, rates, one, other) for other in beside)] for one in above]
    yield table(["", *beside], rows)
    yield _conclusion(found, rates)


def _difference(
    found: Mapping[tuple[str, str], float],
    rates: Mapping[str, NDArray[np.float64]],
    one: str,
    other: str,
) -> str:
    if (one, other) not in found:
        return ""
    points = 100 * (rates[one].mean() - rates[other].mean())
    p = found[one, other]
    return f"{round(points)} ({'<0.01' if p < 0.005 else f'{p:.2f}'})"


def _conclusion(
    found: Mapping[tuple[str, str], float], rates: Mapping[str, NDArray[np.float64]]
) -> str:
    """Say which methods differ, or that there are too few seeds to show any difference."""
    held = f"at a level of {LEVEL:.0%} over {count(len(found), 'pair')}"
    worse: dict[str, list[str]] = {}
    for pair in (each for each, p in found.items() if p <= LEVEL):
        better, other = sorted(pair, key=lambda name: -rates[name].mean())
        worse.setdefault(better, []).append(other)
    if worse:
        apart = (f"{better} than {', '.join(others)}" for better, others in worse.items())
        return f"Significantly better, {held}: {'; '.join(apart)}."
    least = len(found) * min(
        exchange_test(np.zeros(len(rates[one])), np.ones(len(rates[other]))) for one, other in found
    )
    if least > LEVEL:
        return (
            f"With so few seeds no difference can be significant, {held}: the least possible "
            f"p-value is {min(1.0, least):.2f}."
        )
    return f"No difference between methods is significant, {held}."


def across_sizes(methods: Sequence[MethodRuns]) -> Iterator[str]:
    """Yield a table of interquartile means over sizes and seeds, for methods with several sizes."""
    groups: dict[tuple[str, str, str], dict[str, Sequence[Results]]] = {}
    for each in methods:
        size, _, task = each.config.partition("-")
        groups.setdefault((task, each.setup, each.method), {})[size] = each.runs
    rows = []
    for (task, setup, method), by_size in groups.items():
        if len(by_size) > 1:
            tasks = [solved_in(runs, SPLIT).mean(axis=1) for runs in by_size.values()]
            mean, low, high = (100 * each for each in interquartile_mean(tasks))
            several = max(map(len, tasks)) > 1
            told = f"{mean:.1f}" + f" [{low:.1f}, {high:.1f}]" * several
            name = plain(" ".join(part for part in (setup, task) if part))
            runs = str(sum(map(len, tasks)))
            rows.append([name, name_of(method), ", ".join(by_size), runs, told])
    if rows:
        yield "## All sizes\n"
        yield ABOUT_SIZES
        yield table(["setup", "method", "sizes", "runs", "SR"], rows, "lllrr") + "\n"

"""Test whether methods differ significantly over their training runs.

The unit is a training run: each seed gives another policy, and the question is whether a method is
better over seeds, on these labyrinths. The test permutes runs between two methods. A bootstrap over
a few seeds would too often find a difference between equal methods, because few seeds show little
of the variance. The interquartile mean is that of Agarwal et al. (2021), "Deep reinforcement
learning at the edge of the statistical precipice", with a percentile bootstrap over runs.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
from itertools import combinations
from math import comb

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.evaluation.intervals import CONFIDENCE
from pipeline.inspection.shift import holm
from pipeline.machinery.markdown import count

RESAMPLES = 10_000
"""The number of resamples of an interval, and the maximum number of divisions in a test."""

LEVEL = 1 - CONFIDENCE
"""The significance level: a difference counts if its p-value is at most this."""

_ROUNDING = 1e-12
"""The rounding error allowed between equal differences of means."""


Rates = Mapping[str, NDArray[np.float64]]
"""Method -> the success rates of its runs, shape (runs,)."""


def interquartile_mean(tasks: Sequence[NDArray[np.float64]]) -> tuple[float, float, float]:
    """Return the mean of the middle half of all scores, and the ends of its interval.

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
    return value, float(low), float(high)


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


def differences_of(rates: Rates) -> dict[tuple[str, str], float]:
    """Return the p-value of each pair of methods, corrected for all pairs (Holm 1979)."""
    found = {
        (one, other): exchange_test(rates[one], rates[other])
        for one, other in combinations(rates, 2)
    }
    return dict(zip(found, holm([*found.values()]).tolist(), strict=True))


def conclusion(rates: Rates) -> str:
    """Say which of two or more methods differ, or that too few seeds can show no difference."""
    found = differences_of(rates)
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

"""Test whether methods differ significantly over their training runs.

The unit is a training run: each seed gives another policy, and the question is whether a method is
better over seeds, on these labyrinths. The test permutes runs between two methods. The
interquartile mean is that of Agarwal et al. (2021), "Deep reinforcement learning at the edge of the
statistical precipice".
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from itertools import combinations
from math import comb

import numpy as np
from numpy.typing import NDArray

from pipeline.inspection.shift import holm
from pipeline.machinery import count

RESAMPLES = 10_000
"""The maximum number of divisions in a test."""

FEWEST = 5
"""A pair of methods is tested if each has at least this number of runs."""

LEVEL = 0.05
"""The significance level: a difference counts if its p-value is at most this."""

_DIGITS = 12
"""Scores that are equal to this number of decimal places are equal."""

_CLOSE = 1e-9
"""The rounding error allowed between equal statistics; also the variance, in parts of that of all
scores, which counts as none."""

Rates = Mapping[str, NDArray[np.float64]]
"""Method -> the success rates of its runs, shape (runs,)."""


def interquartile_mean(scores: NDArray[np.float64]) -> float:
    """Return the mean of the middle half of scores, shape (runs,).

    The lowest and the highest quarter, rounded down, are left out. Over a few runs a bootstrap of
    this mean is too narrow (three runs of each of three sizes: 78% instead of 95%), so it has no
    interval.
    """
    cut = len(scores) // 4
    return float(np.sort(scores)[cut : len(scores) - cut].mean())


def exchange_test(mine: NDArray[np.float64], others: NDArray[np.float64]) -> float:
    """Return the two-sided p-value of a permutation test of equal means.

    It is the share of all divisions of the runs into groups of these sizes for which Welch's
    statistic, the difference of the means divided by its standard error, is at least as large; if
    there are more than `RESAMPLES` divisions, the share in that many random ones.

    If both methods have the same distribution, the rate of false positives is at most the level,
    for any number of runs (Fisher 1935, "The design of experiments"; Phipson and Smyth 2010). If
    only their means are equal, it approaches the level as the runs increase, because the statistic
    is studentised (Janssen 1997; Chung and Romano 2013). At a level of 5%, with standard deviations
    of 1 and 0.1: 10% for 5 and 5 runs, up to 11% for 5 and 19, 7% for 10 and 10. With fewer than
    `FEWEST` runs it is higher, so `differences_of` leaves them out.

    Args:
        mine: The scores of one method's runs, shape (runs,), two at least.
        others: The scores of the other method's runs, shape (runs,), two at least.
    """
    scores = np.concatenate([mine, others]).round(_DIGITS)
    if np.ptp(scores) == 0:
        return 1.0
    scores -= scores.mean()
    chosen = _divisions(len(mine), len(others))
    (mean, error), (other_mean, other_error) = (
        _mean_and_error(group @ scores, group @ scores**2, int(group[0].sum()))
        for group in (chosen, 1 - chosen)
    )
    least = _CLOSE * float(scores.var())
    statistics = (mean - other_mean) ** 2 / np.maximum(error + other_error, least)
    return float((statistics >= statistics[0] * (1 - _CLOSE) - _CLOSE).mean())


def _mean_and_error(
    sums: NDArray[np.float64], squares: NDArray[np.float64], runs: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the means of groups of runs, and the squares of their standard errors.

    Args:
        sums: The sum of the scores of each group, shape (divisions,).
        squares: The sum of their squares, shape (divisions,).
        runs: The number of runs of a group.
    """
    means = sums / runs
    return means, (squares / runs - means**2) / (runs - 1)


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
    """Return the p-value of each pair of methods, corrected for all pairs (Holm 1979).

    Methods with fewer than `FEWEST` runs are left out.
    """
    enough = [name for name, each in rates.items() if len(each) >= FEWEST]
    p_values = {
        (one, other): exchange_test(rates[one], rates[other])
        for one, other in combinations(enough, 2)
    }
    return dict(zip(p_values, holm([*p_values.values()]).tolist(), strict=True))


def conclusion(rates: Rates) -> str:
    """Say which of two or more methods differ, and which have too few runs to tell."""
    p_values = differences_of(rates)
    few = [name for name, each in rates.items() if len(each) < FEWEST]
    verdicts = [_verdict(rates, p_values)] if p_values else []
    if few:
        verdicts.append(f"No verdict on {', '.join(few)}: it takes {FEWEST} runs of each method.")
    return " ".join(verdicts)


def _verdict(rates: Rates, p_values: Mapping[tuple[str, str], float]) -> str:
    """Say which pairs differ; `found` has their p-values."""
    held = f"at a level of {LEVEL:.0%} over {count(len(p_values), 'pair')}"
    worse: dict[str, list[str]] = {}
    for pair in (each for each, p in p_values.items() if p <= LEVEL + _CLOSE):
        better, other = sorted(pair, key=lambda name: -rates[name].mean())
        worse.setdefault(better, []).append(other)
    if worse:
        apart = (f"{better} than {', '.join(others)}" for better, others in worse.items())
        return f"Significantly better, {held}: {'; '.join(apart)}."
    least = len(p_values) * min(
        exchange_test(np.zeros(len(rates[one])), np.ones(len(rates[other])))
        for one, other in p_values
    )
    if least > LEVEL:
        return (
            f"With so few seeds no difference can be significant, {held}: the least possible "
            f"p-value is {min(1.0, least):.2f}."
        )
    return f"No difference between methods is significant, {held}."

"""Distances between two samples, and permutation tests of whether chance explains them.

A sample consists of independent units: whole episodes, or all episodes of a labyrinth. Additive
counts describe each unit, so a permutation of units only sums counts again and reads no row.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]
Statistic = Callable[[Floats, Floats], Floats]
"""Maps the counts of two samples, shapes (..., counts), to distances, shape (..., distances)."""

PERMUTATIONS = 999
"""Per test; 1,000 with the observed labels, so that p-values are multiples of 0.001."""

BLOCK_BYTES = 1 << 26
"""The memory for the permutations evaluated at a time."""
_ROUNDING = 1e-9
"""Distances that differ by less count as equal: the order of summation causes that much."""
_NOTHING = 1e-14
"""Divergences below this are rounding errors of zero."""


def jensen_shannon(counts_a: ArrayLike, counts_b: ArrayLike) -> Floats:
    """Return the Jensen-Shannon distance of two distributions, from 0 to 1.

    It is the square root of the divergence in bits (Endres and Schindelin, "A new metric for
    probability distributions", IEEE Transactions on Information Theory 49, 2003).

    Args:
        counts_a: How often each value occurs, shape (..., values); not all zero.
        counts_b: As `counts_a`.

    Returns:
        Shape (...).
    """
    counts = [np.asarray(each, np.float64) for each in (counts_a, counts_b)]
    a, b = np.broadcast_arrays(*(each / each.sum(axis=-1, keepdims=True) for each in counts))
    middle = (a + b) / 2
    divergence = (_relative_entropy(a, middle) + _relative_entropy(b, middle)) / 2
    return np.sqrt(np.where(divergence < _NOTHING, 0, divergence))


def _relative_entropy(p: Floats, q: Floats) -> Floats:
    """Return the Kullback-Leibler divergence in bits; q is positive wherever p is."""
    ratio = np.divide(p, q, out=np.ones_like(p), where=p > 0)
    entropy: Floats = (p * np.log2(ratio)).sum(axis=-1)
    return entropy


def wasserstein_of_counts(below_a: ArrayLike, below_b: ArrayLike, gaps: ArrayLike) -> Floats:
    """Return the Wasserstein distance of two samples of values on a grid, from additive counts.

    The distance has order 1: on a line, the area between the two distribution functions.

    Args:
        below_a: The number of values at or below each grid point except the last, then the
            number of all values, shape (..., points). Concatenate several dimensions to add up
            their distances; divide their gaps by the number of dimensions to get the mean.
        below_b: As `below_a`.
        gaps: The distance from each grid point to the next, shape (points - 1,).

    Returns:
        Shape (...).
    """
    a, b = np.asarray(below_a, np.float64), np.asarray(below_b, np.float64)
    area: Floats = np.abs(a[..., :-1] / a[..., -1:] - b[..., :-1] / b[..., -1:]) @ np.asarray(gaps)
    return area


def cohens_d(a: ArrayLike, b: ArrayLike) -> Floats:
    """Return how many pooled standard deviations the mean of b is above that of a.

    Cohen, "Statistical Power Analysis for the Behavioral Sciences", 1988, section 2.2; infinite
    where all values within each sample are equal, but the two samples differ.

    Args:
        a: A value of each unit in each dimension, shape (n, dimensions).
        b: Shape (m, dimensions).

    Returns:
        Shape (dimensions,).
    """
    x, y = np.asarray(a, np.float64), np.asarray(b, np.float64)
    apart: Floats = y.mean(axis=0) - x.mean(axis=0)
    freedom = max(len(x) + len(y) - 2, 1)
    squares = ((x - x.mean(axis=0)) ** 2).sum(axis=0) + ((y - y.mean(axis=0)) ** 2).sum(axis=0)
    apart[np.abs(apart) < _ROUNDING] = 0
    squares[squares < _ROUNDING**2] = 0
    with np.errstate(divide="ignore"):
        np.divide(apart, np.sqrt(squares / freedom), out=apart, where=apart != 0)
    return apart


class Tested(NamedTuple):
    """Distances of two samples, and the probability that chance makes them as large."""

    distances: Floats
    """Shape (distances,)."""
    p_values: Floats
    """Shape (distances,)."""


def permutation_test(
    a: NDArray[Any],
    b: NDArray[Any],
    statistic: Statistic,
    rng: np.random.Generator,
    *,
    paired: bool = False,
) -> Tested:
    """Return the distances of two samples, each with its p-value.

    The p-value is (1 + permutations that reach the distance) / (1 + permutations), valid for any
    number of them (Phipson and Smyth, "Permutation p-values should never be zero", 2010).

    Args:
        a: Counts of each unit, shape (n, counts); whole units are exchanged.
        b: Shape (m, counts).
        statistic: Maps the summed counts of two samples to their distances.
        rng: Draws the permutations.
        paired: Whether unit i of one sample belongs to unit i of the other, and is exchanged
            only with it.
    """
    units = np.concatenate([a, b]).astype(np.float64)
    total = units.sum(axis=0)
    of_a = units[: len(a)].sum(axis=0)
    observed = np.atleast_1d(statistic(of_a, total - of_a))
    reached = np.zeros(len(observed), np.int64)
    block = max(1, BLOCK_BYTES // units.itemsize // len(units))
    for first in range(0, PERMUTATIONS, block):
        chosen = np.zeros((min(block, PERMUTATIONS - first), len(units)))
        if paired:
            chosen[:, : len(a)] = rng.integers(2, size=(len(chosen), len(a)))
            chosen[:, len(a) :] = 1 - chosen[:, : len(a)]
        else:
            for row in chosen:
                row[rng.permutation(len(units))[: len(a)]] = 1
        sums = chosen @ units
        drawn = statistic(sums, total - sums).reshape(len(chosen), -1)
        reached += (drawn >= observed - _ROUNDING).sum(axis=0)
    return Tested(observed, (1 + reached) / (1 + PERMUTATIONS))


def holm(p_values: ArrayLike) -> Floats:
    """Return p-values adjusted for multiple tests: at most `alpha` wherever Holm's test rejects.

    Holm, "A simple sequentially rejective multiple test procedure", 1979.

    Args:
        p_values: The p-values of one family of tests, shape (tests,).

    Returns:
        Shape (tests,), in the same order.
    """
    given = np.asarray(p_values, np.float64)
    order = np.argsort(given, kind="stable")
    steps = np.maximum.accumulate(given[order] * np.arange(len(given), 0, -1))
    corrected = np.empty_like(given)
    corrected[order] = np.minimum(steps, 1)
    return corrected

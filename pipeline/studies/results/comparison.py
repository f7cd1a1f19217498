"""Whether one method does better than another by more than chance.

Two of the figures of Agarwal et al. (2021), "Deep reinforcement learning at the edge of the
statistical precipice": the interquartile mean, and the probability of improvement. Intervals are
percentile bootstrap. Where methods are evaluated in the same labyrinths, labyrinths are resampled
for both together, and seeds for each method by itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.evaluation.intervals import CONFIDENCE

RESAMPLES = 10_000
"""More than elsewhere, as the bounds for many pairs lie far out."""


class Estimate(NamedTuple):
    """A figure and its interval."""

    value: float
    low: float
    high: float


def interquartile_mean(tasks: Sequence[NDArray[np.float64]]) -> Estimate:
    """Return the mean of the middle half of the scores of all runs, and its interval.

    A quarter of the scores, rounded down, is left out on either side. Runs are resampled in each
    task by itself (section 4.3 of the paper).

    Args:
        tasks: The score of each run in each task, shapes (runs,).
    """
    rng = np.random.default_rng(0)
    drawn = [each[rng.integers(len(each), size=(RESAMPLES, len(each)))] for each in tasks]
    (value,) = _middle(np.concatenate(tasks)[None]).tolist()
    return _estimate(value, _middle(np.concatenate(drawn, axis=1)), 1)


def _middle(scores: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the mean of the middle half of each row."""
    cut = scores.shape[1] // 4
    means: NDArray[np.float64] = np.sort(scores)[:, cut : scores.shape[1] - cut].mean(axis=1)
    return means


def improvement(mine: NDArray[np.float64], others: NDArray[np.float64], pairs: int = 1) -> Estimate:
    """Return the probability that one method scores higher than another; a tie counts half.

    The average over labyrinths of the share of pairs of runs in which it does (equation 2 of the
    paper, with labyrinths for tasks).

    Args:
        mine: The score of each run in each labyrinth, shape (runs, labyrinths).
        others: Those of the other method in the same labyrinths.
        pairs: How many pairs of methods are compared; the interval is wider so that all hold
            together (Bonferroni).
    """
    wins = (mine[:, None] > others) + 0.5 * (mine[:, None] == others)
    rng = np.random.default_rng(0)
    # How often each run of either method and each labyrinth is drawn, as a share.
    drawn = [
        rng.multinomial(size, np.full(size, 1 / size), RESAMPLES) / size for size in wins.shape
    ]
    means = np.einsum("ra,rb,rl,abl->r", *drawn, wins, optimize=True)
    return _estimate(float(wins.mean()), means, pairs)


def _estimate(value: float, resampled: NDArray[np.float64], pairs: int) -> Estimate:
    tail = (1 - CONFIDENCE) / 2 / pairs
    low, high = np.quantile(resampled, [tail, 1 - tail])
    return Estimate(value, float(low), float(high))

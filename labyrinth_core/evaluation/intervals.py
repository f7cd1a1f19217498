"""Confidence intervals of means over labyrinths and seeds.

The percentile bootstrap (Efron 1979; Efron and Tibshirani 1993, chapter 13): labyrinths are
resampled with replacement, and so are seeds where there are several. As every seed is evaluated on
the same labyrinths, the two are resampled independently of each other.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

RESAMPLES = 2_000
CONFIDENCE = 0.95
_TOGETHER = 100


def interval(
    values: NDArray[np.float64], minus: NDArray[np.float64] | None = None
) -> tuple[float, float]:
    """Return the bounds of the interval of the mean at the level `CONFIDENCE`.

    The same values give the same bounds. The interval of equal values is that value alone, which
    is too narrow; with few seeds it is too narrow as well.

    Args:
        values: A value for each seed and labyrinth, shape (seeds, labyrinths).
        minus: Values of the same seeds on other labyrinths, whose mean is subtracted.
    """
    rng = np.random.default_rng(0)
    means = [_resampled(values, minus, rng) for _ in range(RESAMPLES // _TOGETHER)]
    tail = (1 - CONFIDENCE) / 2
    low, high = np.quantile(np.concatenate(means), [tail, 1 - tail])
    return float(low), float(high)


def _resampled(
    values: NDArray[np.float64], minus: NDArray[np.float64] | None, rng: np.random.Generator
) -> NDArray[np.float64]:
    seeds = rng.integers(len(values), size=(_TOGETHER, len(values), 1))

    def mean(of: NDArray[np.float64]) -> NDArray[np.float64]:
        labyrinths = rng.integers(of.shape[1], size=(_TOGETHER, 1, of.shape[1]))
        means: NDArray[np.float64] = of[seeds, labyrinths].mean(axis=(1, 2))
        return means

    return mean(values) if minus is None else mean(values) - mean(minus)

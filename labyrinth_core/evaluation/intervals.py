"""Confidence intervals of means over labyrinths and seeds.

The percentile bootstrap (Efron 1979; Efron and Tibshirani 1993, chapter 13) resamples labyrinths
with replacement, and seeds if there are several. Every seed is evaluated on the same labyrinths, so
the two are resampled independently. With many values, 2,000 resamples take too long (ten seconds
for 100,000), but the means are normally distributed, with a variance that needs no resampling (Owen
2007, "The pigeonhole bootstrap").
"""

from __future__ import annotations

from statistics import NormalDist

import numpy as np
from numpy.typing import NDArray

RESAMPLES = 2_000
CONFIDENCE = 0.95
_TAIL = (1 - CONFIDENCE) / 2
_TOGETHER = 100

MOST_RESAMPLED = 5_000
"""Above this many values, the normal approximation replaces resampling."""


def interval(
    values: NDArray[np.float64], minus: NDArray[np.float64] | None = None
) -> tuple[float, float]:
    """Return the bounds of the interval of the mean at the level `CONFIDENCE`.

    The bounds are deterministic. If all values are equal, the interval is that single value, which
    is too narrow; with few seeds it is too narrow as well.

    Args:
        values: A value for each seed and labyrinth, shape (seeds, labyrinths).
        minus: Values of the same seeds on other labyrinths, whose mean is subtracted.
    """
    if values.size > MOST_RESAMPLED:
        return _normal(values, minus)
    rng = np.random.default_rng(0)
    means = [_resampled(values, minus, rng) for _ in range(RESAMPLES // _TOGETHER)]
    low, high = np.quantile(np.concatenate(means), [_TAIL, 1 - _TAIL])
    return float(low), float(high)


def _normal(values: NDArray[np.float64], minus: NDArray[np.float64] | None) -> tuple[float, float]:
    """Return the bounds of the interval of many values, from the variance of resampled means.

    This sums three variances, each divided by the number of draws: of the seeds' means, of the
    labyrinths' means, and of the residuals.
    """
    parts = [values] if minus is None else [values, minus]
    of_seeds = values.mean(axis=1) - (0 if minus is None else minus.mean(axis=1))
    variance = float(of_seeds.var()) / len(values)
    for part in parts:
        of_labyrinths, rest = part.mean(axis=0), part - part.mean(axis=1, keepdims=True)
        variance += float(of_labyrinths.var()) / len(of_labyrinths)
        rest -= of_labyrinths - part.mean()
        variance += float(np.square(rest).mean()) / part.size
    mean, margin = float(of_seeds.mean()), NormalDist().inv_cdf(1 - _TAIL) * variance**0.5
    low, high = values.min(), values.max()
    if minus is not None:
        low, high = low - minus.max(), high - minus.min()
    return max(mean - margin, float(low)), min(mean + margin, float(high))


def _resampled(
    values: NDArray[np.float64], minus: NDArray[np.float64] | None, rng: np.random.Generator
) -> NDArray[np.float64]:
    seeds = rng.integers(len(values), size=(_TOGETHER, len(values), 1))

    def mean(of: NDArray[np.float64]) -> NDArray[np.float64]:
        labyrinths = rng.integers(of.shape[1], size=(_TOGETHER, 1, of.shape[1]))
        means: NDArray[np.float64] = of[seeds, labyrinths].mean(axis=(1, 2))
        return means

    return mean(values) if minus is None else mean(values) - mean(minus)

"""Confidence intervals of means over labyrinths and seeds, without resampling.

The interval of one seed says how this policy does on other labyrinths; that of several seeds, how
other seeds of the method do. Every seed is evaluated on the same labyrinths, so the variance of the
mean is the variance by seeds plus the variance by labyrinths, minus the residual that both contain
(Owen 2007, "The pigeonhole bootstrap"). The margin is a quantile of Student's t, with the degrees
of freedom of Satterthwaite (1946).

This alone would be too narrow near the ends of the range, and would have no width at 0% or 100%. So
z^2 labyrinths are added, half with the lowest possible value and half with the highest, as by
Agresti and Coull (1998), "Approximate is better than exact". docs/studies/results.md has a
simulation of how often the interval contains the true mean.
"""

from __future__ import annotations

from math import inf, pi, sqrt, tan
from statistics import NormalDist
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

CONFIDENCE = 0.95
_Z = NormalDist().inv_cdf((1 + CONFIDENCE) / 2)

_DIGITS = 12
"""Bounds are rounded to this number of decimal places, since processors round sums differently."""


def interval(
    values: NDArray[np.float64],
    minus: NDArray[np.float64] | None = None,
    ends: tuple[float, float] = (0.0, 1.0),
) -> tuple[float, float]:
    """Return the bounds of the interval of the mean at the level `CONFIDENCE`.

    The mean of the values is always within the bounds.

    Args:
        values: A value for each seed and labyrinth, shape (seeds, labyrinths).
        minus: Values of the same seeds on other labyrinths, whose mean is subtracted.
        ends: The lowest and the highest possible value, of `minus` as well.
    """
    low, high = ends
    if minus is None:
        lowest, highest, parts = low, high, [_part(values, low, high, _Z**2)]
    else:
        lowest, highest = low - high, high - low
        others = _part(-minus, -high, -low, _Z**2 / 2)
        parts = [_part(values, low, high, _Z**2 / 2), others]
    seeds = len(values)
    of_seeds = np.sum([each.of_seeds for each in parts], axis=0)
    by_seeds = float(of_seeds.var(ddof=seeds > 1)) / seeds
    by_labyrinths = sum(each.by_labyrinths for each in parts)
    # Both variances contain the residual, but their sum is no less than either.
    variance = by_seeds + by_labyrinths - sum(each.residual for each in parts)
    variance = max(variance, by_seeds, by_labyrinths) + sum(each.added for each in parts)
    squares = by_seeds**2 / max(seeds - 1, 1)
    squares += sum(each.by_labyrinths**2 / max(each.labyrinths - 1, 1) for each in parts)
    freedom = max(variance**2 / squares, 1) if squares else inf
    margin = _quantile(freedom) * sqrt(variance)
    mean, centre = float(values.mean()), float(of_seeds.mean())
    if minus is not None:
        mean -= float(minus.mean())
    bounds = max(min(mean, centre - margin), lowest), min(max(mean, centre + margin), highest)
    return round(bounds[0], _DIGITS), round(bounds[1], _DIGITS)


class _Part(NamedTuple):
    """The mean over a set of labyrinths and some added ones, and the parts of its variance."""

    of_seeds: NDArray[np.float64]
    """The mean of each seed, shape (seeds,)."""
    labyrinths: int
    by_labyrinths: float
    """The variance of the mean by the choice of labyrinths."""
    residual: float
    """How much of the variance by labyrinths, and by seeds, is residual."""
    added: float
    """The variance of the mean by the added labyrinths."""


def _part(values: NDArray[np.float64], low: float, high: float, added: float) -> _Part:
    """Return the mean of values and of as many labyrinths as `added`, half of each end."""
    seeds, labyrinths = values.shape
    share = labyrinths / (labyrinths + added)
    rows, columns = values.mean(axis=1), values.mean(axis=0)
    mean, middle = float(values.mean()), (low + high) / 2
    rest = values - rows[:, None] - columns + mean
    several = seeds > 1 and labyrinths > 1
    between = share * (mean - middle) ** 2 + ((high - low) / 2) ** 2
    return _Part(
        share * rows + (1 - share) * middle,
        labyrinths,
        share**2 * float(columns.var(ddof=several)) / labyrinths,
        share**2 * float(np.square(rest).mean()) / ((seeds - 1) * (labyrinths - 1) or inf),
        (1 - share) * between / (labyrinths + added),
    )


def _quantile(freedom: float) -> float:
    """Return the quantile of Student's t for the upper bound; `freedom` is at least 1.

    With t = sqrt(freedom) * tan(angle), the density of the angle is a power of its cosine.
    """
    if freedom > 1_000:
        return _Z
    angles = np.linspace(0, pi / 2, 1_001)
    density = np.cos(angles) ** (freedom - 1)
    below = np.cumsum(density[1:] + density[:-1])
    angle = np.interp(CONFIDENCE * below[-1], below, angles[1:])
    return sqrt(freedom) * tan(angle)

"""How far apart first observations are, for arrays; equality says nothing of continuous ones."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

MOST_SEEDS = 1_000
"""The maximum number of seeds whose first observations are compared."""
MOST_VALUES = 1_024
"""The maximum size of an observation that is compared."""


@dataclass(frozen=True)
class Spread:
    """How far two first observations are apart, as shares of the range of all observations."""

    seeds: int
    """The number of first observations, all pairs of which are compared."""
    values: int
    """The number of values of an observation that ever change."""
    share: float
    """The distance of two first observations as a share of the value's range in the probes.

    It is the mean over the values that change and over all pairs; 0 if every episode begins in the
    same way, 1/3 if first observations are evenly distributed over the range.
    """


class Ranges:
    """Gathers the first observation of some seeds, and the range of all their observations."""

    def __init__(self) -> None:
        self.first: list[Floats] = []
        self.low: Floats | None = None
        self.high: Floats | None = None

    def add(self, seeds: Iterable[Iterable[NDArray[Any]]]) -> None:
        """Add the observations of some seeds, each in order; an array has several alike."""
        groups: dict[int, tuple[list[NDArray[Any]], list[NDArray[Any]]]] = {}
        for observations in seeds:
            tables = [
                observation.reshape(len(observation), -1)
                for observation in observations
                if 0 < observation[0].size <= MOST_VALUES
            ]
            if len({table.shape[1] for table in tables}) == 1:
                first, every = groups.setdefault(tables[0].shape[1], ([], []))
                first.append(tables[0][0])
                every += tables
        for first, every in groups.values():
            values = np.concatenate(every).T.astype(np.float64, order="C")  # Its rows are quick.
            firsts = [*np.stack(first).astype(np.float64)]
            self.join(firsts, values.min(axis=1), values.max(axis=1))

    def join(self, first: Sequence[Floats], low: Floats | None, high: Floats | None) -> None:
        """Add the first observations and the range of other seeds."""
        if low is None or high is None or (self.low is not None and self.low.shape != low.shape):
            return
        self.first += first
        self.low = low if self.low is None else np.minimum(self.low, low)
        self.high = high if self.high is None else np.maximum(self.high, high)

    def spread(self) -> Spread | None:
        """Return the spread; None if fewer than two observations are finite arrays of one size."""
        if self.low is None or self.high is None or len(self.first) < 2:
            return None
        width = self.high - self.low
        if not np.isfinite(width).all():
            return None
        changing = width > 0
        apart = manhattan_distances(np.stack(self.first))[changing] / width[changing]
        share = float(apart.mean()) if changing.any() else 0.0
        return Spread(len(self.first), int(changing.sum()), share)


def manhattan_distances(points: Floats) -> Floats:
    """Return the distance between two points in each dimension, averaged over all pairs.

    Args:
        points: Shape (n, dimensions), n at least 2.
    """
    count = len(points)
    # The i-th sorted value (from 0) is above i others and below count - 1 - i.
    weights = 2.0 * np.arange(count) - (count - 1)
    return np.asarray(weights @ np.sort(points, axis=0) / (count * (count - 1) / 2), np.float64)

"""How many levels there are, how many of test are in train, and how far apart observations are.

Counts, shares and estimates of levels that are the same or not; for arrays also the distance
between first observations, since equality says nothing of continuous ones.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from math import ceil, exp, floor, log1p
from statistics import NormalDist
from typing import Any

import numpy as np
from numpy.typing import NDArray

Digests = NDArray[np.uint64]
"""One digest for each seed, shape (seeds,)."""

Floats = NDArray[np.float64]

Z = NormalDist().inv_cdf(0.975)

MOST_SEEDS = 1_000
"""The maximum number of seeds whose first observations are compared."""
MOST_VALUES = 1_024
"""The maximum size of an observation that is compared."""


def wilson(count: int, of: int) -> tuple[float, float]:
    """Return Wilson's 95% interval of a share (Wilson 1927, JASA 22, p. 209)."""
    centre, width = count + Z * Z / 2, Z * (count * (of - count) / of + Z * Z / 4) ** 0.5
    low, high = (centre - width) / (of + Z * Z), (centre + width) / (of + Z * Z)
    return (low if count else 0.0), (high if count < of else 1.0)


@dataclass(frozen=True)
class Share:
    """How many of some seeds have a property."""

    count: int
    of: int
    """The number of seeds, those at which the environment failed left out."""

    @property
    def share(self) -> float:
        """The share, from 0 to 1."""
        return self.count / self.of

    @property
    def interval(self) -> tuple[float, float]:
        """Wilson's 95% interval of the share."""
        return wilson(self.count, self.of)

    def __str__(self) -> str:
        low, high = (percent(bound) for bound in self.interval)
        return f"{self.count:,} of {self.of:,}, {percent(self.share)}% ({low} to {high}%)"


def percent(share: float) -> str:
    """Return a share in percent with one decimal; only 0 and 1 are shown as 0 and 100."""
    text = f"{100 * share:.1f}"
    if text == "0.0":
        return "0" if share == 0 else f"{100 * share:.2g}"
    if text == "100.0":
        return "100" if share == 1 else ">99.9"
    return text


def shared(train: Digests, test: Digests) -> Share:
    """Return how many seeds of test have a digest of train."""
    return Share(int(np.isin(test, train).sum()), len(test))


def curve(train: Digests, test: Digests) -> tuple[tuple[int, int], ...]:
    """Return how many seeds of test have a digest of the first m of train, for growing m.

    Returns:
        Pairs (m, count), for m of 1, 2, 5, 10, ... and for all of train.
    """
    known, first = np.unique(train, return_index=True)
    at = np.minimum(np.searchsorted(known, test), len(known) - 1)
    places = np.sort(first[at[known[at] == test]])
    return tuple((m, int(np.searchsorted(places, m))) for m in _sizes(len(train)))


def _sizes(most: int) -> Iterator[int]:
    size = 1
    while size < most:
        yield size
        size = size * 5 // 2 if str(size)[0] == "2" else size * 2
    yield most


@dataclass(frozen=True)
class Levels:
    """How many levels some seeds gave, and what that says about all levels."""

    by: str
    """The measure by which two levels are the same: state, probes or first."""
    seeds: int
    """The number of different seeds, or of episodes of a dataset."""
    seen: int
    """The number of different levels."""
    once: int
    """The number of levels that one seed gave."""
    twice: int
    """The number of levels that two seeds gave."""
    unit: str = "seed"

    @classmethod
    def of(cls, by: str, digests: Digests, unit: str = "seed") -> Levels:
        """Return the levels of different seeds, or of episodes."""
        _, counts = np.unique(digests, return_counts=True)
        seen, once, twice = len(counts), int((counts == 1).sum()), int((counts == 2).sum())
        return cls(by, len(digests), seen, once, twice, unit)

    @property
    def coverage(self) -> float:
        """The share of new seeds whose level has been seen, by Good and Turing.

        One minus the share of seeds whose level no other seed gave (Good 1953, Biometrika 40).
        """
        return 1 - self.once / self.seeds

    @property
    def at_least(self) -> int:
        """A lower bound of the number of levels: Chao1, bias-corrected, rounded down.

        Its expectation is below the number of levels, and equal to it if all are equally likely
        (Chao 1984; Chao 2005, Encyclopedia of Statistical Sciences, "Species estimation"). A single
        estimate may be above it, and is rough while few levels repeat: see `interval`.
        """
        return self.seen + self.once * (self.once - 1) // (2 * (self.twice + 1))

    @property
    def interval(self) -> tuple[int, int]:
        """The 95% interval of `at_least`, rounded outwards: wide while few levels repeat.

        It is an interval of the bound: there may be more levels, if some are rarer than others. Of
        1,000 seeds that choose among 1,000 to 100,000 equally likely levels, 92 to 97% give an
        interval with this number, and at most 3% one above it; too low are most of those that
        choose among 300,000 or more, of which at most two levels repeat.

        The number of levels that were not seen is taken to be log-normal (Chao 1987, Biometrics 43,
        p. 783), with the variance of the bias-corrected estimate (Colwell 2013, EstimateS 9.1,
        appendix B).
        """
        once, twice = self.once, self.twice
        unseen = once * (once - 1) / (2 * (twice + 1))
        if not unseen:
            return self.seen, self.seen
        variance = (
            unseen
            + once * (2 * once - 1) ** 2 / (4 * (twice + 1) ** 2)
            + once**2 * twice * (once - 1) ** 2 / (4 * (twice + 1) ** 4)
        )
        factor = exp(Z * log1p(variance / unseen**2) ** 0.5)
        return self.seen + floor(unseen / factor), self.seen + ceil(unseen * factor)

    def __str__(self) -> str:
        if self.once == self.seeds > 1:  # Chao1 would be a square of the number of seeds.
            return f"no two of {self.seeds:,} {self.unit}s gave the same level (by {self.by})"
        if self.seen == 1 < self.seeds:
            same = f"all {self.seeds:,} {self.unit}s gave the same level (by {self.by})"
            return f"{same}: the {self.unit} changes nothing that is seen"
        low, high = self.interval
        between = f"; 95% interval of this bound {low:,} to {high:,}" if low < high else ""
        return (
            f"{self.seeds:,} {self.unit}s gave {self.seen:,} levels (by {self.by}); "
            f"{percent(self.coverage)}% of new {self.unit}s give one of these (Good-Turing); "
            f"there are at least {self.at_least:,} (Chao1{between})"
        )


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

"""How many levels there are, and how many of test are in train: counts, shares, estimates."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from math import ceil, exp, floor, log1p
from statistics import NormalDist

import numpy as np
from numpy.typing import NDArray

Digests = NDArray[np.uint64]
"""One digest for each seed, shape (seeds,)."""

Z = NormalDist().inv_cdf(0.975)


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

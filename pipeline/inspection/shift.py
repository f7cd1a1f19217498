"""How much two splits differ, and whether chance explains it: six measures, tested by permutation.

| measure | compares | distance |
|---|---|---|
| actions | how often each action is taken | Jensen-Shannon, 0 to 1 |
| trajectories | the agent's row and column in every state, scaled to 0 to 1 | mean Wasserstein |
| states | the same, and every passage: open 1, closed 0 | mean Wasserstein |
| route length | moves of a shortest route | Wasserstein, in moves |
| branching | cells with three or four passages | Wasserstein, in cells |
| loops | passages beyond those of a spanning tree | Wasserstein, in passages |

A sample consists of independent units: whole episodes, or all episodes of a labyrinth. Additive
counts describe each unit, so a permutation of units only sums counts again and reads no row.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pipeline.inspection.near_twins import passage_table
from pipeline.inspection.statistics import Content

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
    a, b = (each / each.sum(axis=-1, keepdims=True) for each in counts)
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
    values = np.asarray(p_values, np.float64)
    order = np.argsort(values, kind="stable")
    steps = np.maximum.accumulate(values[order] * np.arange(len(values), 0, -1))
    corrected = np.empty_like(values)
    corrected[order] = np.minimum(steps, 1)
    return corrected


class Sample(NamedTuple):
    """One measure of a split."""

    counts: NDArray[np.int64]
    """Additive counts of each labyrinth, shape (labyrinths, counts)."""
    values: Floats
    """Each labyrinth's mean, for the effect size, shape (labyrinths, dimensions)."""
    distance: Statistic
    """Maps the summed counts of two samples to their distance."""


@dataclass(frozen=True)
class MeasuredShift:
    """How two splits differ in one measure."""

    measure: str
    first: str
    second: str
    labyrinths: tuple[int, int]
    """The number of labyrinths of each split; permutations exchange whole labyrinths.

    If both splits have the same structures in the same order, only equal structures are exchanged.
    """
    distance: float
    effect: float
    """Cohen's d of the labyrinths' means, positive if those of the second split are larger.

    With several dimensions, the mean of the absolute values.
    """
    p_value: float
    corrected: float
    """The p-value after Holm's correction, over all measures and pairs of one `compare` call."""

    def to_json(self) -> dict[str, Any]:
        """Return plain types; distance and effect to six decimals, an infinite effect as None."""
        effect = round(self.effect, 6) if np.isfinite(self.effect) else None
        return vars(self) | {"distance": round(self.distance, 6), "effect": effect}


def compare(
    contents: Mapping[str, Content],
    pairs: list[tuple[str, str]],
    seed: int,
) -> list[MeasuredShift]:
    """Return how the splits of each pair differ, in all measures.

    Args:
        contents: The content of each split.
        pairs: The names of the splits to compare; all their tests are one family for Holm.
        seed: The seed of the permutations.
    """
    shifts = []
    for number, (first, second) in enumerate(pairs):
        a, b = contents[first], contents[second]
        most = max(int(max(a.moves.max(), b.moves.max())), a.visits[0].size)
        samples = [(name, of(a, most), of(b, most)) for name, of in MEASURES.items()]
        tested = permutation_test(
            np.concatenate([of_a.counts for _, of_a, _ in samples], axis=1),
            np.concatenate([of_b.counts for _, _, of_b in samples], axis=1),
            _side_by_side([of_a for _, of_a, _ in samples]),
            np.random.default_rng([seed, number]),
            paired=[each.structure for each in a.labyrinths]
            == [each.structure for each in b.labyrinths],
        )
        for (name, of_a, of_b), distance, p in zip(samples, *tested, strict=True):
            d = cohens_d(of_a.values, of_b.values)
            effect = float(d[0] if len(d) == 1 else np.abs(d).mean())
            sizes = len(a.labyrinths), len(b.labyrinths)
            shifts.append((name, first, second, sizes, float(distance), effect, float(p)))
    corrected = holm([each[-1] for each in shifts]).tolist()
    return [MeasuredShift(*each, p) for each, p in zip(shifts, corrected, strict=True)]


def _side_by_side(samples: list[Sample]) -> Statistic:
    """Return the statistic that maps concatenated counts to the distance of each sample."""
    ends = np.cumsum([sample.counts.shape[1] for sample in samples])[:-1]

    def distances(a: Floats, b: Floats) -> Floats:
        parts = zip(samples, np.split(a, ends, axis=-1), np.split(b, ends, axis=-1), strict=True)
        return np.stack([sample.distance(of_a, of_b) for sample, of_a, of_b in parts], axis=-1)

    return distances


def _actions(content: Content, _: int) -> Sample:
    taken = content.actions
    return Sample(taken, taken / taken.sum(axis=1, keepdims=True), jensen_shannon)


def _trajectories(content: Content, _: int) -> Sample:
    below, gaps, values = _positions(content)
    return _on_a_grid(below, gaps, values, content.visits.sum(axis=(1, 2)))


def _states(content: Content, _: int) -> Sample:
    below, gaps, values = _positions(content)
    states = content.visits.sum(axis=(1, 2))
    passages = passage_table([labyrinth.structure for labyrinth in content.labyrinths])
    below = np.concatenate([below, states[:, None] * ~passages], axis=1)
    gaps = np.concatenate([gaps, np.ones(passages.shape[1])])
    return _on_a_grid(below, gaps, np.concatenate([values, passages], axis=1), states)


def _positions(content: Content) -> tuple[NDArray[np.int64], Floats, Floats]:
    """Return states at or below each row and column but the last, the gaps, and mean positions."""
    below, gaps, means = [], [], []
    for axis in (2, 1):
        visits = content.visits.sum(axis=axis)
        steps = visits.shape[1] - 1
        below.append(visits.cumsum(axis=1)[:, :-1])
        gaps.append(np.full(steps, 1 / steps))
        means.append(visits @ np.linspace(0, 1, steps + 1) / visits.sum(axis=1))
    return np.concatenate(below, axis=1), np.concatenate(gaps), np.stack(means, axis=1)


def _on_a_grid(
    below: NDArray[np.int64], gaps: Floats, values: Floats, totals: NDArray[np.int64]
) -> Sample:
    """Return the sample whose distance is the mean Wasserstein distance of all dimensions."""
    shares = gaps / values.shape[1]
    return Sample(
        np.concatenate([below, totals[:, None]], axis=1),
        values,
        lambda a, b: wasserstein_of_counts(a, b, shares),
    )


def _numbers(values: NDArray[np.int64], most: int) -> Sample:
    """Return the sample of one integer per labyrinth, from 0 to `most`."""
    below = (values[:, None] <= np.arange(most)).astype(np.int64)
    return _on_a_grid(below, np.ones(most), values[:, None].astype(float), np.ones_like(values))


MEASURES: dict[str, Callable[[Content, int], Sample]] = {
    "actions": _actions,
    "trajectories": _trajectories,
    "states": _states,
    "route length": lambda content, most: _numbers(content.moves, most),
    "branching": lambda content, most: _numbers(
        np.array([each.structure.junctions for each in content.labyrinths]), most
    ),
    "loops": lambda content, most: _numbers(
        np.array([each.structure.loops for each in content.labyrinths]), most
    ),
}
"""Name -> function from a split and an upper bound of all lengths and counts to the sample."""

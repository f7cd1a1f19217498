"""The six measures by which splits are compared, each computed from additive counts per labyrinth.

| measure | compares | distance |
|---|---|---|
| actions | how often each action is taken | Jensen-Shannon, 0 to 1 |
| trajectories | the agent's row and column in every state, scaled to 0 to 1 | mean Wasserstein |
| states | the same, and every passage: open 1, closed 0 | mean Wasserstein |
| route length | moves of a shortest route | Wasserstein, in moves |
| branching | cells with three or four passages | Wasserstein, in cells |
| loops | passages beyond those of a spanning tree | Wasserstein, in passages |
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pipeline.inspection.counts import Content
from pipeline.inspection.near_twins import passage_table
from pipeline.inspection.shift import (
    Floats,
    Statistic,
    cohens_d,
    holm,
    jensen_shannon,
    permutation_test,
    wasserstein_of_counts,
)


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
    found = []
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
            found.append((name, first, second, sizes, float(distance), effect, float(p)))
    corrected = holm([each[-1] for each in found]).tolist()
    return [MeasuredShift(*each, p) for each, p in zip(found, corrected, strict=True)]


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

"""Measure the differences between the episodes of even and of odd seeds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from environments.summaries import Discretisation, Summary
from labyrinth_core.benchmarks.levels import manhattan_distances
from pipeline.inspection import holm
from pipeline.inspection.shift import Floats, cohens_d, permutation_test

PAIRS = 1_000
"""The maximum number of pairs of episodes, one from each half, that are compared individually."""


@dataclass(frozen=True)
class Difference:
    """The difference between the two halves, in their actions or in their states."""

    distance: float
    """Jensen-Shannon for discrete actions; else Wasserstein, averaged over dimensions."""
    p_value: float
    """From a permutation test that exchanges whole episodes."""
    effect: float
    """The absolute value of Cohen's d between means of episodes, averaged over dimensions."""
    two_episodes: float
    """The same distance between two episodes, averaged over up to `PAIRS` pairs."""
    holm: float = 1.0
    """The p-value with Holm's correction over the whole report, set by `corrected`."""


@dataclass(frozen=True)
class Variation:
    """How much the episodes of an environment's expert vary."""

    name: str
    seeds: int
    steps: int
    average_reward: float
    reward_deviation: float
    """The standard deviation of the returns (ddof 0)."""
    least_reward: float
    actions: Difference
    states: Difference
    """The states are scaled to [0, 1]; dimensions that never change are left out."""
    state_distances: tuple[float, ...]
    """The distance in each scaled dimension of the state; 0 in those that never change."""
    first_states: float
    """The Manhattan distance between two first states, averaged over all pairs."""
    first_states_scaled: float
    """The same distance in scaled dimensions, averaged over those that change."""
    beyond: float
    """The distance of states beyond the points of the discretisation, as a share of their range."""


def measure(name: str, discretisation: Discretisation, summary: Summary, seed: int) -> Variation:
    """Return how the episodes of even seeds (0, 2, ...) differ from those of odd seeds.

    Args:
        name: The name of the environment.
        discretisation: The points at which its values were counted.
        summary: The summary of all episodes, in the order of the seeds 0, 1, ...
        seed: The seed of the permutations.
    """
    scale = summary.highest - summary.lowest
    changing = scale > 0
    unit = np.where(changing, scale, 1)

    def distances(a: Floats, b: Floats) -> Floats:
        actions, states = discretisation.distances(a, b)
        return np.stack([actions, (states / unit)[..., changing].mean(axis=-1)], axis=-1)

    even, odd = summary.counts[::2], summary.counts[1::2]
    tested = permutation_test(even, odd, distances, np.random.default_rng([seed, *name.encode()]))
    pairs = min(PAIRS, len(odd))
    two = distances(even[:pairs].astype(float), odd[:pairs].astype(float)).mean(axis=0)
    effect = np.abs(cohens_d(summary.means[::2], summary.means[1::2]))
    first_of_states = len(effect) - len(scale)
    effects = effect[:first_of_states].mean(), effect[first_of_states:][changing].mean()
    actions, states = (
        Difference(*map(float, numbers)) for numbers in zip(*tested, effects, two, strict=True)
    )
    ends = np.array([(each[0], each[-1]) for each in discretisation.states.points])
    outside = np.maximum(ends[:, 0] - summary.lowest, summary.highest - ends[:, 1]) / unit
    apart = manhattan_distances(summary.first)
    _, in_each = discretisation.distances(even.sum(axis=0), odd.sum(axis=0))
    return Variation(
        name=name,
        seeds=len(summary.totals),
        steps=int(summary.steps.sum()),
        average_reward=float(summary.totals.mean()),
        reward_deviation=float(summary.totals.std()),
        least_reward=float(summary.totals.min()),
        actions=actions,
        states=states,
        state_distances=tuple((in_each / unit).tolist()),
        first_states=float(apart.sum()),
        first_states_scaled=float((apart / unit)[changing].mean()),
        beyond=float(max(outside.max(), 0)),
    )


def corrected(results: Sequence[Variation]) -> list[Variation]:
    """Return the results with Holm's correction over all their p-values."""
    p_values = [[each.actions.p_value, each.states.p_value] for each in results]
    adjusted = holm(np.ravel(p_values)).reshape(-1, 2)
    return [
        replace(
            each,
            actions=replace(each.actions, holm=float(of_actions)),
            states=replace(each.states, holm=float(of_states)),
        )
        for each, (of_actions, of_states) in zip(results, adjusted, strict=True)
    ]

"""Augmented random search: linear policies found by trying directions, without gradients.

Mania, Guy and Recht, "Simple random search of static linear policies is competitive for
reinforcement learning", NeurIPS 2018, algorithm 2, version V2-t.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

FIRST_SEED = 2**32
"""Least seed of an episode that the search plays; those below are fresh for evaluation."""

Play = Callable[[NDArray[np.float64], NDArray[np.float64], int], tuple[float, NDArray[np.float64]]]
"""`(gain, bias, seed)` -> return and observations, shape (T, observation), of one episode.

The policy is `gain @ observation + bias`.
"""


@dataclass(frozen=True)
class Settings:
    """The hyperparameters."""

    step_size: float
    directions: int
    noise: float
    top: int
    """Directions, the best of those tried, that the step is made of."""


@dataclass(frozen=True)
class Search:
    """A search between two iterations: all that the next one depends on."""

    seed: int
    iteration: int
    weights: NDArray[np.float64]
    """Of the policy on normalised observations, shape (action, observation)."""
    count: int
    """Observations seen so far, of which the next two are statistics."""
    mean: NDArray[np.float64]
    """Shape (observation,)."""
    squares: NDArray[np.float64]
    """Sum of squared distances from the mean, shape (observation,)."""

    @classmethod
    def start(cls, seed: int, actions: int, observations: int) -> Search:
        """Return the search that has seen nothing: the policy that always answers zero."""
        zeros = np.zeros(observations)
        return cls(seed, 0, np.zeros((actions, observations)), 0, zeros, zeros)

    def policy(
        self, weights: NDArray[np.float64] | None = None
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return gain and bias on plain observations, of these weights or its own."""
        weights = self.weights if weights is None else weights
        if not self.count:
            return weights, np.zeros(len(weights))
        deviation = np.sqrt(self.squares / self.count)
        # A dimension that never changed says nothing, so it has no say.
        scale = np.divide(1, deviation, out=np.zeros_like(deviation), where=deviation > 1e-7)
        gain = weights * scale
        return gain, -gain @ self.mean


def improve(search: Search, settings: Settings, play: Play) -> Search:
    """Return the search after one iteration; the same search gives the same one, always."""
    rng = np.random.default_rng([search.seed, search.iteration])
    directions = rng.standard_normal((settings.directions, *search.weights.shape))
    seeds = rng.integers(FIRST_SEED, 2**63, size=settings.directions)
    returns = np.empty((settings.directions, 2))
    after = search
    for index, direction in enumerate(directions):
        for side, sign in enumerate((1, -1)):
            policy = search.policy(search.weights + sign * settings.noise * direction)
            # Both sides start in the same state, so that their difference is the direction's.
            returns[index, side], observations = play(*policy, int(seeds[index]))
            after = _observe(after, observations)
    best = np.argsort(-returns.max(axis=1), kind="stable")[: settings.top]
    deviation = returns[best].std()
    weights = search.weights
    if deviation > 0:
        differences = returns[best, 0] - returns[best, 1]
        step = np.tensordot(differences, directions[best], axes=1)
        weights = weights + settings.step_size / (settings.top * deviation) * step
    return replace(after, iteration=search.iteration + 1, weights=weights)


def _observe(search: Search, observations: NDArray[np.float64]) -> Search:
    """Return the search with these observations in its statistics (Chan et al., 1979)."""
    added = len(observations)
    count = search.count + added
    mean = observations.mean(axis=0)
    shift = mean - search.mean
    squares = ((observations - mean) ** 2).sum(axis=0)
    return replace(
        search,
        count=count,
        mean=search.mean + shift * added / count,
        squares=search.squares + squares + shift**2 * search.count * added / count,
    )

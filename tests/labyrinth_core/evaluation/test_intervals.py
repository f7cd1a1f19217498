"""Intervals by the bootstrap: where the mean lies, and how far it could be off."""

from __future__ import annotations

import numpy as np
import pytest

from labyrinth_core.evaluation.intervals import interval


def test_an_interval_holds_the_mean_and_is_the_same_every_time():
    values = np.random.default_rng(0).random((3, 40))
    low, high = interval(values)
    assert low < values.mean() < high
    assert interval(values) == (low, high)
    # Known: the mean of L labyrinths has the standard error std / sqrt(L).
    one = np.random.default_rng(1).normal(size=(1, 4000))
    low, high = interval(one)
    assert (high - low) / 2 == pytest.approx(1.96 * one.std() / np.sqrt(4000), rel=0.1)


def test_seeds_that_disagree_widen_the_interval_and_are_paired_in_a_difference():
    agreeing = np.tile(np.arange(50) % 2, (4, 1)).astype(float)
    low, high = interval(agreeing)
    disagreeing = np.repeat([[0.0], [1.0], [0.0], [1.0]], 50, axis=1)
    wider_low, wider_high = interval(disagreeing)
    assert wider_high - wider_low > 2 * (high - low)
    assert interval(disagreeing, disagreeing) == (0, 0)


@pytest.mark.slow
@pytest.mark.parametrize("shape", [(1, 6_000), (3, 2_000), (600, 10)])
def test_the_interval_of_many_values_is_that_of_the_bootstrap_without_resampling(shape):
    rng = np.random.default_rng(5)
    seeds, labyrinths = rng.normal(size=(shape[0], 1)), rng.normal(size=shape[1])
    values = seeds + labyrinths + rng.normal(size=shape)
    drawn = [
        values[rng.integers(shape[0], size=(shape[0], 1)), rng.integers(shape[1], size=shape[1])]
        for _ in range(2_000)
    ]
    expected = np.quantile([each.mean() for each in drawn], [0.025, 0.975])
    assert interval(values) == pytest.approx(expected, abs=0.1 * (expected[1] - expected[0]))
    few = values[:, :1]
    bounds = interval(values, few)
    assert bounds[0] < values.mean() - few.mean() < bounds[1]
    assert interval(np.ones(shape)) == (1, 1)

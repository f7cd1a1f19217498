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

"""Intervals contain the true mean as often as they promise, also at 0%, at 100% and of few seeds.

The simulation of several seeds, SPL and gaps is a table of docs/studies/results.md, which
`tests/scripts/results/certify/test_pages.py` makes again in part and holds against the promise.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from labyrinth_core.evaluation.scores import Scores, interval


def first(solved, labyrinths):
    """Return the values of one seed that solves the first labyrinths."""
    return (np.arange(labyrinths) < solved).astype(np.float64)[None]


@pytest.mark.parametrize("labyrinths", [12, 32, 100])
def test_of_all_outcomes_of_one_seed_at_most_seven_percent_leave_its_success_rate_out(labyrinths):
    bounds = [interval(first(solved, labyrinths)) for solved in range(labyrinths + 1)]
    low, high = np.array(bounds).T
    for share in np.linspace(0.02, 0.98, 193):
        chances = stats.binom.pmf(np.arange(labyrinths + 1), labyrinths, share)
        assert chances[(low <= share) & (share <= high)].sum() >= 0.93


def test_the_interval_contains_its_mean_and_has_a_width_where_all_or_none_is_solved():
    rng = np.random.default_rng(0)
    for seeds, labyrinths in ((1, 1), (1, 9), (2, 1), (2, 2), (3, 9), (5, 100), (2, 9)):
        for share in (0, 0.1, 0.5, 0.7, 1):
            values = (rng.random((seeds, labyrinths)) < share) * rng.random((seeds, labyrinths))
            low, high = interval(values)
            assert 0 <= low <= values.mean() <= high <= 1
            assert high - low > 0.04
            assert (low, high) == interval(values)
            gap = interval(values, 1 - values[:, :1])
            assert -1 <= gap[0] <= values.mean() - (1 - values[:, :1]).mean() <= gap[1] <= 1
    low, high = interval(first(0, 100), first(100, 100))
    assert (low, high) == (-1, pytest.approx(-0.95, abs=0.01))


def test_many_values_have_the_standard_error_of_seeds_and_labyrinths_together():
    rng = np.random.default_rng(1)
    one = rng.random((1, 20_000))
    low, high = interval(one)
    assert (high - low) / 2 == pytest.approx(1.96 * one.std() / np.sqrt(20_000), rel=0.01)
    of_seeds, of_labyrinths = rng.normal(0, 0.05, (400, 1)), rng.normal(0, 0.1, 900)
    low, high = interval(0.5 + of_seeds + of_labyrinths)
    error = np.hypot(of_seeds.std() / 20, of_labyrinths.std() / 30)
    assert (high - low) / 2 == pytest.approx(1.96 * error, rel=0.05)


def test_the_spread_of_few_seeds_counts_by_the_quantile_of_students_t():
    of_seeds = np.array([0.45, 0.5, 0.55])
    low, high = interval(np.tile(of_seeds[:, None], 10_000))
    margin = stats.t.ppf(0.975, 2) * of_seeds.std(ddof=1) / np.sqrt(3)
    assert (low, high) == pytest.approx((0.5 - margin, 0.5 + margin), abs=1e-3)


def test_seeds_are_paired_in_a_difference():
    of_seeds = np.tile([[0.2], [0.5], [0.8]], 1_000)
    low, high = interval(of_seeds, of_seeds)
    assert high - low < 0.05
    low, high = interval(of_seeds, of_seeds[::-1])
    assert high - low > 1


def test_the_interval_of_returns_is_that_of_success_in_their_range():
    solved = first(90, 100)
    low, high = interval(solved)
    bounds = Scores.return_interval(np.where(solved == 1, 1.0, -4.0))
    assert bounds == pytest.approx((-4 + 5 * low, -4 + 5 * high))
    on_ice = Scores.return_interval(np.where(solved == 1, 1.0, -100.9))
    assert on_ice == pytest.approx((-100.9 + 101.9 * low, -100.9 + 101.9 * high))

"""The statistics of shift, against SciPy's and against what can be worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.distance import jensenshannon
from scipy.stats import kstest, permutation_test, wasserstein_distance

from pipeline.inspection import shift

SEEDS = st.integers(0, 2**32 - 1)


@given(SEEDS, st.integers(2, 8))
def test_the_jensen_shannon_distance_is_scipys(seed, values):
    rng = np.random.default_rng(seed)
    a, b = rng.integers(0, 5, (2, values)) + np.eye(values, dtype=int)[:2]
    assert shift.jensen_shannon(a, b) == pytest.approx(jensenshannon(a, b, base=2), abs=1e-9)


@given(SEEDS, st.integers(1, 30), st.integers(1, 30))
def test_the_wasserstein_distance_from_counts_on_a_grid_is_scipys_of_the_values(seed, n, m):
    rng = np.random.default_rng(seed)
    points = np.cumsum(rng.uniform(0.1, 1, 6))
    a, b = rng.integers(6, size=n), rng.integers(6, size=m)
    below = [np.bincount(values, minlength=6).cumsum() for values in (a, b)]
    assert shift.wasserstein_of_counts(*below, np.diff(points)) == pytest.approx(
        wasserstein_distance(points[a], points[b])
    )


def test_the_effect_size_is_the_distance_of_means_in_standard_deviations():
    a, b = [[1.0, 2.0, 3.0], [3.0, 2.0, 3.0]], [[3.0, 2.0, 4.0], [5.0, 2.0, 4.0]]
    assert shift.cohens_d(a, b) == pytest.approx([2 / np.sqrt(2), 0, np.inf])


def test_holms_correction_is_the_one_worked_out_by_hand():
    assert shift.holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])
    assert shift.holm([0.5, 0.6]).tolist() == [1, 1]
    assert shift.holm([]).size == 0


def difference_of_means(a, b):
    return np.abs(a[..., :1] / a[..., 1:] - b[..., :1] / b[..., 1:])


def test_with_few_units_the_p_value_is_that_of_all_permutations(monkeypatch):
    monkeypatch.setattr(shift, "PERMUTATIONS", 20_000)
    a, b = np.array([0.0, 1, 2, 2.5]), np.array([2.0, 3, 4, 6])
    exact = permutation_test(
        (a, b), lambda x, y: abs(x.mean() - y.mean()), alternative="greater", n_resamples=np.inf
    )
    units = [np.stack([values, np.ones(4)], axis=1) for values in (a, b)]
    tested = shift.permutation_test(*units, difference_of_means, np.random.default_rng(0))
    assert tested.distances == pytest.approx([exact.statistic])
    assert tested.p_values == pytest.approx([exact.pvalue], abs=0.005)


def episodes(rng, count, shares):
    """Return how often each of four actions was taken in each of some episodes."""
    lengths = rng.integers(4, 12, count)
    own = rng.dirichlet(np.array(shares) * 4, count)  # No two episodes behave alike.
    return np.array([rng.multinomial(n, p) for n, p in zip(lengths, own, strict=True)])


def action_shift(a, b):
    return shift.jensen_shannon(a, b)[..., None]


def test_p_values_are_uniform_where_nothing_differs(monkeypatch):
    monkeypatch.setattr(shift, "PERMUTATIONS", 199)
    rng = np.random.default_rng(7)
    shares = [0.4, 0.3, 0.2, 0.1]
    p_values = [
        shift.permutation_test(
            episodes(rng, 15, shares), episodes(rng, 25, shares), action_shift, rng
        ).p_values[0]
        for _ in range(300)
    ]
    # Multiples of 1/200, which moves the distribution function by that much at most.
    assert kstest(p_values, "uniform").statistic < 1.63 / np.sqrt(300) + 1 / 200  # The 1% bound.
    assert 0.02 < np.mean(np.array(p_values) <= 0.05) < 0.09


def test_samples_that_are_the_same_have_a_p_value_of_1():
    units = episodes(np.random.default_rng(1), 20, [1, 1, 1, 1])
    tested = shift.permutation_test(units, units, action_shift, np.random.default_rng(0))
    assert tested.distances.tolist() == [0]
    assert tested.p_values.tolist() == [1]


def test_permutations_worked_on_in_blocks_are_the_same(monkeypatch):
    rng = np.random.default_rng(2)
    a, b = episodes(rng, 20, [2, 1, 1, 1]), episodes(rng, 30, [1, 1, 1, 2])
    whole = shift.permutation_test(a, b, action_shift, np.random.default_rng(3))
    monkeypatch.setattr(shift, "BLOCK_BYTES", 5_000)
    cut = shift.permutation_test(a, b, action_shift, np.random.default_rng(3))
    assert cut.p_values.tolist() == whole.p_values.tolist()

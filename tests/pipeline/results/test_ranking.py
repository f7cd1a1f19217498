"""Which methods do better than which: by hand, against SciPy, and in the tables."""

from __future__ import annotations

from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import ttest_ind

from labyrinth_core.evaluation import Results
from pipeline.results.tables import (
    conclusion,
    exchange_test,
    interquartile_mean,
)

pytestmark = pytest.mark.slow

PUBLISHED = Path(__file__).parents[3] / "docs/results/runs"


def test_the_interquartile_mean_leaves_out_a_quarter_on_either_side():
    scores = np.array([8.0, 1, 7, 2, 6, 3, 5, 100])
    assert interquartile_mean(scores) == np.mean([3, 5, 6, 7])
    assert interquartile_mean(np.array([1.0, 2, 6])) == 3  # A quarter of three is none.
    assert interquartile_mean(np.array([0.5])) == 0.5


@pytest.mark.parametrize(
    ("mine", "others", "expected"),
    [
        ([1, 2, 3], [4, 5, 6], 2 / 20),  # Of twenty divisions, this and its opposite.
        ([1, 2, 4], [3, 5, 6], 4 / 20),
        ([1, 2], [5, 6, 7], 1 / 10),  # The opposite has groups of other sizes.
        ([0.3, 0.3, 0.3], [0.1 + 0.2, 0.3], 1),  # Equal but for rounding.
        ([0.1] * 5, [0.9] * 5, 2 / 252),  # Without any spread.
    ],
)
def test_a_difference_is_as_rare_as_the_divisions_of_the_runs_that_have_it(mine, others, expected):
    groups = np.array(mine, np.float64), np.array(others, np.float64)
    assert exchange_test(*groups) == exchange_test(*groups[::-1]) == pytest.approx(expected)


def test_the_divisions_are_compared_by_the_statistic_of_welch():
    rng = np.random.default_rng(3)
    mine, others = rng.normal(0, 1, 4), rng.normal(1, 0.1, 7)
    scores, found = np.concatenate([mine, others]), []
    for chosen in combinations(range(11), 4):
        left = np.delete(scores, chosen)
        found.append(abs(ttest_ind(scores[list(chosen)], left, equal_var=False).statistic))
    expected = np.mean(np.array(found) >= found[0] - 1e-9)
    assert exchange_test(mine, others) == pytest.approx(expected)


def test_of_more_divisions_than_are_counted_a_random_part_gives_nearly_the_same():
    rng = np.random.default_rng(0)
    mine, others = rng.normal(0, 1, 20), rng.normal(0.6, 1, 20)
    expected = ttest_ind(mine, others, equal_var=False).pvalue
    assert exchange_test(mine, others) == pytest.approx(expected, abs=0.01)


@pytest.mark.parametrize(("runs", "others", "most"), [(5, 5, 0.12), (5, 19, 0.14), (10, 10, 0.09)])
def test_equal_means_of_unequal_spread_are_told_apart_no_more_often_than_is_said(
    runs, others, most
):
    rng = np.random.default_rng(0)
    found = [
        exchange_test(rng.normal(0, 1, runs), rng.normal(0, 0.1, others)) <= 0.05
        for _ in range(500)
    ]
    assert np.mean(found) <= most


def test_on_methods_with_fewer_than_five_runs_there_is_no_verdict():
    low, high = np.linspace(0.40, 0.44, 5), np.linspace(0.90, 0.94, 5)
    rates = {"a": low, "b": high, "c": high[:4]}
    told = conclusion(rates)
    assert told.startswith("Significantly better, at a level of 5% over 1 pair: b than a.")
    none = "No verdict on c: it takes 5 runs of each method."
    assert told.endswith(f" {none}")
    assert conclusion({"c": high[:4], "d": low[:1]}) == none.replace("c:", "c, d:")


@pytest.fixture(scope="module")
def published() -> list[Results]:
    """Return the published runs of the six methods at 5x5, three of each."""
    return [
        Results.load(PUBLISHED / f"5x5/{method}-cnn-seed{seed}.json")
        for method in ("bc", "dagger", "gail", "bco", "sqil", "iupe")
        for seed in range(3)
    ]


def test_of_a_thousand_relabellings_at_most_one_in_twenty_tells_equal_methods_apart(published):
    rates = np.array([each.splits["test"].sr for each in published])
    rng = np.random.default_rng(0)

    def relabelled() -> dict[str, np.ndarray]:
        return dict(zip("abc", np.split(rng.permutation(rates), 3), strict=True))

    apart = sum(conclusion(relabelled()).startswith("Significantly") for _ in range(1000))
    assert 10 < apart <= 50


def test_twenty_seeds_tell_four_points_apart_and_say_of_which_pairs():
    rng = np.random.default_rng(0)
    means = {"a": 0.42, "b": 0.42, "c": 0.46}
    rates = {name: rng.normal(mean, 0.03, 20) for name, mean in means.items()}
    told = conclusion(rates)
    assert told == "Significantly better, at a level of 5% over 3 pairs: c than a, b."


def test_what_is_significant_of_one_pair_may_not_be_of_three():
    low, high = np.linspace(0.40, 0.44, 5), np.linspace(0.43, 0.47, 5)
    assert 0.05 / 3 < exchange_test(low, high) <= 0.05
    assert conclusion({"a": low, "b": high}).endswith(": b than a.")
    rates = {"a": low, "b": high, "c": (low + high) / 2}
    assert conclusion(rates).startswith("No difference between methods is significant")


def test_what_is_significant_is_said(published):
    bc, dagger = (
        np.array([each.splits["test"].sr for each in published if each.run.method == method])
        for method in ("bc", "dagger")
    )
    told = conclusion({"BC": np.tile(bc, 2), "DAgger": np.tile(dagger, 2)})  # As if of six seeds.
    assert told.startswith("Significantly better, at a level of 5%")
    assert told.endswith(": BC than DAgger.")

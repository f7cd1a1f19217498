"""Which methods do better than which: by hand, by resampling one at a time, and in the tables."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.stats import ttest_ind

from labyrinth_core.evaluation.results import Results
from pipeline.results.comparison import (
    conclusion,
    differences_of,
    exchange_test,
    interquartile_mean,
)
from pipeline.results.entry import entries_of
from pipeline.results.paper import name_of

pytestmark = pytest.mark.slow

PUBLISHED = Path(__file__).parents[3] / "docs/results/runs"


def test_the_interquartile_mean_leaves_out_a_quarter_on_either_side():
    scores = np.array([8.0, 1, 7, 2, 6, 3, 5, 100])
    assert interquartile_mean([scores])[0] == np.mean([3, 5, 6, 7])
    assert interquartile_mean([scores[:3], scores[3:]])[0] == np.mean([3, 5, 6, 7])
    assert interquartile_mean([np.array([1.0, 2, 6])])[0] == 3  # A quarter of three is none.
    assert interquartile_mean([np.array([0.5]), np.array([0.25])]) == (0.375, 0.375, 0.375)


def test_runs_are_resampled_in_each_size_by_itself():
    rng = np.random.default_rng(7)
    tasks = [rng.normal(0, 1, 8), rng.normal(5, 1, 8)]
    means = []
    for _ in range(4000):
        drawn = np.sort(np.concatenate([rng.choice(each, len(each)) for each in tasks]))
        means.append(drawn[4:12].mean())
    _, *bounds = interquartile_mean(tasks)
    assert bounds == pytest.approx(np.quantile(means, [0.025, 0.975]), abs=0.05)


@pytest.mark.parametrize(
    ("mine", "others", "expected"),
    [
        ([1, 2, 3], [4, 5, 6], 2 / 20),  # Of twenty divisions, this and its opposite.
        ([1, 2, 4], [3, 5, 6], 4 / 20),
        ([1, 2], [5, 6, 7], 1 / 10),  # The opposite has groups of other sizes.
        ([0.3, 0.3, 0.3], [0.1 + 0.2, 0.3], 1),  # Equal but for rounding.
        ([1], [0], 1),
    ],
)
def test_a_difference_is_as_rare_as_the_divisions_of_the_runs_that_have_it(mine, others, expected):
    groups = np.array(mine, np.float64), np.array(others, np.float64)
    assert exchange_test(*groups) == exchange_test(*groups[::-1]) == pytest.approx(expected)


def test_of_more_divisions_than_are_counted_a_random_part_gives_nearly_the_same():
    rng = np.random.default_rng(0)
    mine, others = rng.normal(0, 1, 20), rng.normal(0.6, 1, 20)
    assert exchange_test(mine, others) == pytest.approx(ttest_ind(mine, others).pvalue, abs=0.01)


@pytest.fixture(scope="module")
def published() -> list[Results]:
    """Return the published runs of the six methods at 5x5, three of each."""
    return [
        Results.load(PUBLISHED / f"5x5/{method}-cnn-seed{seed}.json")
        for method in ("bc", "dagger", "gail", "bco", "sqil", "iupe")
        for seed in range(3)
    ]


def test_of_a_thousand_relabellings_at_most_one_in_twenty_tells_equal_methods_apart(published):
    rates = np.concatenate([each.rates for each in entries_of(published)])
    rng = np.random.default_rng(0)

    def relabelled() -> dict[str, np.ndarray]:
        return dict(zip("abc", np.split(rng.permutation(rates), 3), strict=True))

    apart = sum(min(differences_of(relabelled()).values()) <= 0.05 for _ in range(1000))
    assert 10 < apart <= 50


def test_twenty_seeds_tell_four_points_apart_and_say_of_which_pairs():
    rng = np.random.default_rng(0)
    means = {"a": 0.42, "b": 0.42, "c": 0.46}
    rates = {name: rng.normal(mean, 0.03, 20) for name, mean in means.items()}
    found = differences_of(rates)
    assert list(found) == [("a", "b"), ("a", "c"), ("b", "c")]
    assert found["a", "b"] > 0.05 > max(found["a", "c"], found["b", "c"])
    alone = {pair: exchange_test(rates[pair[0]], rates[pair[1]]) for pair in found}
    smallest = min(alone, key=alone.__getitem__)
    assert found[smallest] == pytest.approx(3 * alone[smallest])
    assert all(found[pair] >= alone[pair] for pair in found)


def test_what_is_significant_is_said(published):
    runs = 2 * published[:3] + 2 * published[3:6]  # As if of six seeds.
    told = conclusion({name_of(each.run.method): each.rates for each in entries_of(runs)})
    assert told.startswith("Significantly better, at a level of 5%")
    assert told.endswith(": BC than DAgger.")

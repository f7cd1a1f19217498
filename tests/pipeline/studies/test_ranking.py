"""Which methods do better than which: by hand, by resampling one at a time, and in the tables."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from labyrinth_core.evaluation.results import Results
from pipeline.studies.results.comparison import (
    Estimate,
    across_sizes,
    improvement,
    interquartile_mean,
    pairs_of_methods,
)

PUBLISHED = Path(__file__).parents[3] / "docs/results/runs"


def shown(rows: str) -> np.ndarray:
    """Return 1 for each + and 0 for each -, a row for each run."""
    return np.array([[letter == "+" for letter in row] for row in rows.split()], np.float64)


def test_the_interquartile_mean_leaves_out_a_quarter_on_either_side():
    scores = np.array([8.0, 1, 7, 2, 6, 3, 5, 100])
    assert interquartile_mean([scores]).value == np.mean([3, 5, 6, 7])
    assert interquartile_mean([scores[:3], scores[3:]]).value == np.mean([3, 5, 6, 7])
    assert interquartile_mean([np.array([1.0, 2, 6])]).value == 3  # A quarter of three is none.
    assert interquartile_mean([np.array([0.5]), np.array([0.25])]) == Estimate(0.375, 0.375, 0.375)


def test_runs_are_resampled_in_each_size_by_itself():
    rng = np.random.default_rng(7)
    tasks = [rng.normal(0, 1, 8), rng.normal(5, 1, 8)]
    means = []
    for _ in range(4000):
        drawn = np.sort(np.concatenate([rng.choice(each, len(each)) for each in tasks]))
        means.append(drawn[4:12].mean())
    estimate = interquartile_mean(tasks)
    expected = np.quantile(means, [0.025, 0.975])
    assert (estimate.low, estimate.high) == pytest.approx(expected, abs=0.05)


@pytest.mark.parametrize(
    ("mine", "others", "expected"),
    [
        ("++--", "+---", (0.5 + 1 + 0.5 + 0.5) / 4),
        ("+- ++", "-- +-", ((1 + 0.5 + 1 + 0.5) / 4 + (0.5 + 0.5 + 1 + 1) / 4) / 2),
        ("++ ++", "-- --", 1),
        ("+-+", "+-+ +-+ +-+", 0.5),
    ],
)
def test_the_probability_of_improvement_counts_pairs_of_runs_and_half_of_ties(
    mine, others, expected
):
    assert improvement(shown(mine), shown(others)).value == pytest.approx(expected)
    assert improvement(shown(others), shown(mine)).value == pytest.approx(1 - expected)


def test_seeds_of_each_method_and_labyrinths_of_both_are_resampled():
    rng = np.random.default_rng(3)
    mine, others = (rng.random((3, 40)) < share for share in (0.6, 0.4))
    estimate = improvement(mine.astype(float), others.astype(float))
    means = []
    for _ in range(4000):
        labyrinths = rng.integers(40, size=40)
        one, other = (of[rng.integers(3, size=3)][:, labyrinths].mean() for of in (mine, others))
        means.append(0.5 + (one - other) / 2)  # So it is where scores are 0 and 1.
    assert estimate.value == pytest.approx(0.5 + (mine.mean() - others.mean()) / 2)
    expected = np.quantile(means, [0.025, 0.975])
    assert (estimate.low, estimate.high) == pytest.approx(expected, abs=0.01)
    wider = improvement(mine.astype(float), others.astype(float), pairs=15)
    assert wider.low < estimate.low < estimate.high < wider.high


def test_no_ranking_is_printed_where_none_is_significant():
    names = [f"{method}-cnn-seed{seed}" for method in ("bc", "sqil") for seed in range(3)]
    runs = [Results.load(PUBLISHED / "5x5" / f"{name}.json") for name in names]
    _, table, conclusion = pairs_of_methods(runs)
    assert "| BC |  | 52 |" in table
    assert "| SQIL | 48 |  |" in table
    assert conclusion.endswith("There is no ranking.")
    assert list(pairs_of_methods(runs[:3])) == []


def test_what_is_significant_is_said():
    bc, planner = (
        Results.load(PUBLISHED / f"5x5/{run}-seed0.json") for run in ("bc-cnn", "planner")
    )
    *_, conclusion = pairs_of_methods([bc, planner])
    assert conclusion.endswith(": planner than BC.")


def test_sizes_are_put_together_where_there_are_several():
    runs = [Results.load(path) for path in sorted(PUBLISHED.glob("*/bc-cnn-seed[0-9].json"))]
    (text,) = [part for part in across_sizes(runs) if part.startswith("| setup")]
    assert "| cnn | BC | 3x3, 4x4, 5x5 | 9 | " in text
    assert list(across_sizes(runs[:3])) == []

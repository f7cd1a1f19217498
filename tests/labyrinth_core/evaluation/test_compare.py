"""Two policies compared until it is decided: equal ones are rarely told apart, others soon."""

from __future__ import annotations

from itertools import islice
from math import comb

import numpy as np
import pytest
from support.labyrinths_of_datasets import CONFIGS
from support.policies import Chance, chance

from labyrinth_core import compare, load_arrays
from labyrinth_core.data import Drawing, Manifest
from labyrinth_core.evaluation import PolicyError
from labyrinth_core.evaluation.compare import Comparison
from labyrinth_core.language import labyrinth_id


def right(observations):
    return np.full(len(observations), 1)


def test_the_expected_evidence_against_equally_good_policies_is_one():
    for count in (1, 2, 7, 30):
        found = [
            Comparison(count, 0, wins, count - wins, steps=25, error=0.05)
            for wins in range(count + 1)
        ]
        mean = sum(comb(count, each.wins) / 2**count * each.evidence for each in found)
        assert mean == pytest.approx(1)


@pytest.mark.slow
def test_equally_good_policies_are_told_apart_in_at_most_a_twentieth_of_simulations():
    rng = np.random.default_rng(0)
    apart = 0
    for wins in rng.binomial(8, 0.5, size=(1_000, 100)).cumsum(axis=1).tolist():
        looks = ((won, 8 * count - won) for count, won in enumerate(wins, 1))
        apart += any(Comparison(0, 0, *look, steps=25, error=0.05).better for look in looks)
    assert 0 < apart <= 50


@pytest.mark.slow
def test_the_share_of_wins_lies_within_the_interval_at_all_times_together():
    rng = np.random.default_rng(0)
    outside = 0
    for wins in rng.binomial(100, 0.7, size=(100, 10)).cumsum(axis=1).tolist():
        looks = [(won, 100 * count - won) for count, won in enumerate(wins, 1)]
        bounds = [Comparison(0, 0, *look, steps=25, error=0.05).interval for look in looks]
        outside += not all(low <= 0.7 <= high for low, high in bounds)
        widths = [high - low for low, high in bounds]
        assert widths[-1] < widths[0] / 2
    assert outside <= 5


@pytest.mark.parametrize(("wins", "losses"), [(10_000, 0), (0, 10_000)])
def test_the_interval_of_a_policy_that_always_wins_ends_at_its_edge(wins, losses):
    low, high = Comparison(wins + losses, 0, wins, losses, steps=25, error=0.05).interval
    low, high = (low, high) if wins else (1 - high, 1 - low)
    assert 0.999 <= low < high == 1


@pytest.mark.parametrize("config", CONFIGS.values())
def test_fresh_labyrinths_are_on_structures_of_test_alone_and_follow_from_the_seed(
    datasets, config
):
    dataset = Manifest.read(datasets / config).config
    drawn, again = (
        list(islice(Drawing(dataset).sample_test(np.random.default_rng(1)), 20)) for _ in range(2)
    )
    assert drawn == again
    assert {dataset.bucket_of(each.structure) for each in drawn} == {"test"}
    assert {each.task for each in drawn} == {dataset.task}
    train = load_arrays(datasets, config, "train", observation="vector")
    assert not {int(labyrinth_id(each), 16) for each in drawn} & {*train.labyrinth_ids.tolist()}


@pytest.mark.slow
def test_the_better_policy_is_found_either_way_round_and_again(datasets):
    options = {"observation": ("vector", "image"), "image_size": 8, "within": "limit"}
    found = compare(chance, right, datasets, "3x4", **options)
    assert found.better == "first"
    assert found == compare(Chance(), right, datasets, "3x4", **options)
    other = compare(right, chance, datasets, "3x4", **options | {"observation": "vector"})
    assert (other.better, other.wins, other.losses) == ("other", found.losses, found.wins)
    assert other.difference == -found.difference
    assert str(found).startswith(f"the first policy is better, after {found.labyrinths} labyrinths")


def test_a_policy_is_never_better_than_itself(datasets):
    found = compare(right, right, datasets, "3x4", observation="vector", most=100)
    assert (found.better, found.labyrinths) == (None, 100)
    assert found.evidence == pytest.approx(1)
    assert found.interval == (0, 1)
    assert str(found).startswith("not decided, after 100 labyrinths: within 12 steps the first")


def test_a_function_that_draws_at_random_without_rng_is_refused(datasets):
    rng = np.random.default_rng(0)
    for policies in (
        (right, lambda seen: rng.integers(4, size=len(seen))),
        (lambda seen: rng.integers(4, size=len(seen)), right),
    ):
        with pytest.raises(PolicyError, match="answers the same observations differently: give it"):
            compare(*policies, datasets, "3x4", observation="vector")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"most": 0}, "most=0: give a whole number from 1 to 1000000000"),
        ({"seed": "a"}, "seed='a': give a whole number from 0 to "),
        ({"error": 1}, "error=1: give a probability above 0 and below 1"),
        ({"within": "9"}, "within='9': choose cells or limit"),
        ({"observation": "sound"}, "observation=sound: choose one of image, vector, text"),
        ({"image_size": (8, 601)}, "image_size=601: give a whole number from 1 to 600"),
        ({"image_size": (8, 8, 8)}, r"image_size=\(8, 8, 8\): give one value, or a pair"),
    ],
)
def test_an_argument_that_is_not_allowed_is_refused(datasets, options, message):
    with pytest.raises(ValueError, match=message):
        compare(right, right, datasets, "3x4", **options)

"""Counts and estimates of levels, against hand-computed values and a plain count."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from labyrinth_core.benchmarks import Certificate, Levels, Share, wilson
from labyrinth_core.benchmarks.records import Split

DIGESTS = st.lists(st.integers(0, 8), min_size=1, max_size=30)


def array(numbers):
    return np.array(numbers, np.uint64)


@pytest.mark.parametrize(
    ("digests", "seen", "coverage", "at_least"),
    [
        ([1, 1, 2, 3, 3, 3], 3, 5 / 6, 3),  # f1 = 1, f2 = 1: 3 + 1 * 0 / 4.
        ([1, 2, 3, 4, 4, 5, 5], 5, 4 / 7, 6),  # f1 = 3, f2 = 2: 5 + 3 * 2 / 6.
        ([1, 2, 3, 4], 4, 0, 10),  # f1 = 4, f2 = 0: 4 + 4 * 3 / 2.
        ([7, 7, 7], 1, 1, 1),
        ([1, 2, 3, 4, 4], 4, 2 / 5, 5),  # f1 = 3, f2 = 1: 4 + 3 * 2 / 4 = 5.5.
    ],
)
def test_good_turing_and_chao1_are_those_computed_by_hand(digests, seen, coverage, at_least):
    levels = Levels.of("probes", array(digests))
    assert (levels.seen, levels.at_least) == (seen, at_least)
    assert levels.coverage == pytest.approx(coverage)


def test_the_interval_of_chao1_covers_equally_likely_levels_and_narrows_as_they_repeat():
    rng = np.random.default_rng(0)
    widths = []
    for number in (1_000, 10_000, 100_000):
        drawn = [Levels.of("state", rng.integers(number, size=1_000)) for _ in range(200)]
        intervals = [each.interval for each in drawn if each.once < each.seeds]
        covered = sum(low <= number <= high for low, high in intervals) / len(intervals)
        assert 0.9 <= covered <= 1
        assert np.mean([each.at_least for each in drawn]) == pytest.approx(number, rel=0.15)
        widths.append(np.median([high / low for low, high in intervals]))
    assert widths == sorted(widths)
    assert Levels("state", 1000, 922, 852, 63).interval == (5213, 8399)
    assert "at least 48 (Chao1)" in str(Levels("state", 1000, 48, 0, 0))


def test_levels_of_which_none_was_seen_twice_promise_no_number():
    assert (
        str(Levels.of("state", array([1, 2, 3])))
        == "no two of 3 seeds gave the same level (by state)"
    )
    assert str(Levels.of("probes", array([1, 1]))).endswith(
        ": the seed changes nothing that is seen"
    )


def test_wilsons_interval_is_that_of_the_literature():
    # Newcombe 1998, Statistics in Medicine 17, table I.
    assert wilson(81, 263) == pytest.approx((0.2553, 0.3662), abs=1e-4)
    assert wilson(15, 148) == pytest.approx((0.0624, 0.1605), abs=1e-4)
    assert wilson(0, 20) == pytest.approx((0, 0.1611), abs=1e-4)
    assert wilson(20, 20)[1] == 1
    assert str(Share(0, 20)) == "0 of 20, 0% (0 to 16.1%)"
    assert "<" not in str(Share(1, 10**6))
    assert str(Share(1, 10**6)).startswith("1 of 1,000,000, 0.0001%")
    assert ">99.9%" in str(Share(10**6 - 1, 10**6))


@given(DIGESTS, DIGESTS)
def test_the_share_and_its_curve_are_a_plain_count(train, test):
    splits = (Split(tuple(range(len(some))), {"first": array(some)}) for some in (train, test))
    certificate = Certificate("Env", {}, {}, *splits)
    share, points = certificate.first, certificate.curves["first"]
    assert (share.count, share.of) == (sum(each in train for each in test), len(test))
    assert points == tuple((m, sum(each in train[:m] for each in test)) for m, _ in points)
    assert points[-1] == (len(train), share.count)
    assert [m for m, _ in points[:-1]] == [m for m in (1, 2, 5, 10, 20) if m < len(train)]

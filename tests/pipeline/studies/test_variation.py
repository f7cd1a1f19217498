"""What tells two halves of the seeds apart is measured right, from counts alone."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import wasserstein_distance

from pipeline.studies.environments.discretisation import Axes, Discretisation
from pipeline.studies.environments.environment import Environment, Trajectory
from pipeline.studies.environments.summaries import Summary
from pipeline.studies.environments.variation import corrected, manhattan_distances, measure

SEEDS = st.integers(0, 2**32 - 1)


def noise(shift: float = 0, *, discrete: bool = True) -> Environment:
    """Return an environment of noise; that of odd seeds is elsewhere, by `shift`."""

    def play(seed: int) -> Trajectory:
        rng = np.random.default_rng(seed)
        moved = shift * (seed % 2)
        states = np.stack(
            [rng.normal(moved, size=31), rng.integers(0, 5, 31), np.full(31, 7)], axis=1
        )
        choices = np.minimum(rng.integers(0, 3, 30) + round(moved), 2)
        actions = choices if discrete else rng.uniform(-1, 1, (30, 2)) * (1 - moved / 2)
        return Trajectory(states, actions, float(seed))

    return Environment(
        play, 3 if discrete else (np.full(2, -1.0), np.ones(2)), lambda states: states[:, :2]
    )


def summed(of: Environment, seeds: int = 40) -> tuple[Discretisation, Summary]:
    discretisation = Discretisation.around(of, map(of.play, range(10)))
    return discretisation, Summary.of(of, discretisation, range(seeds))


@given(SEEDS, st.integers(1, 40), st.integers(1, 40))
def test_counts_of_whole_numbers_give_scipys_distance(seed, n, m):
    rng = np.random.default_rng(seed)
    a, b = rng.integers(0, 9, (n, 2)).astype(float), rng.integers(3, 20, (m, 2)).astype(float)
    axes = Axes.through(np.concatenate([a, b]))
    expected = [wasserstein_distance(a[:, i], b[:, i]) for i in range(2)]
    assert axes.distances(axes.counts(a), axes.counts(b)) == pytest.approx(expected)


@given(SEEDS)
def test_counts_of_real_numbers_give_scipys_distance_within_two_hundredths(seed):
    rng = np.random.default_rng(seed)
    a, b = rng.normal(size=(2_000, 1)), rng.gamma(2, size=(2_000, 1))
    axes = Axes.through(np.concatenate([a, b]))
    expected = wasserstein_distance(a[:, 0], b[:, 0])
    assert axes.distances(axes.counts(a), axes.counts(b))[0] == pytest.approx(expected, rel=0.02)


def test_counts_of_episodes_add_up_to_those_of_their_values_together():
    of = noise()
    discretisation, summary = summed(of, 6)
    together = np.concatenate([of.play(seed).states for seed in range(6)])
    counts = summary.counts.sum(axis=0)
    assert counts[:3].sum() == 6 * 30
    assert np.array_equal(counts[3:], discretisation.states.counts(together))


@pytest.mark.parametrize("discrete", [True, False])
def test_other_points_have_another_fingerprint(discrete):
    first, again, other = (summed(noise(s, discrete=discrete), 4)[0] for s in (0, 0, 0.1))
    assert first.fingerprint == again.fingerprint != other.fingerprint


def test_summaries_of_parts_join_to_that_of_the_whole():
    discretisation, summary = summed(noise(), 9)
    joined = Summary.joined(
        [Summary.of(noise(), discretisation, part) for part in (range(4), range(4, 9))]
    )
    for field in fields(Summary):
        assert np.array_equal(getattr(summary, field.name), getattr(joined, field.name))


def test_visits_are_told_apart_by_the_half_of_the_seed():
    of = noise()
    discretisation, summary = summed(of)
    for half in (0, 1):
        places = np.concatenate([of.play(seed).states[:, 1::-1] for seed in range(half, 40, 2)])
        expected = np.histogramdd(places, (discretisation.up, discretisation.across))[0]
        assert np.array_equal(summary.visits[half], expected)


@given(SEEDS, st.integers(2, 12))
def test_the_mean_distance_of_all_pairs_is_that_of_brute_force(seed, n):
    points = np.random.default_rng(seed).integers(0, 6, (n, 2)).astype(float)
    pairs = [abs(points[i] - points[j]) for i in range(n) for j in range(i)]
    assert manhattan_distances(points) == pytest.approx(np.mean(pairs, axis=0))


@pytest.mark.parametrize("discrete", [True, False])
def test_a_planted_shift_is_found_and_chance_is_not(discrete):
    moved = measure("moved", *summed(noise(1.0, discrete=discrete)), seed=0)
    same = measure("same", *summed(noise(0.0, discrete=discrete)), seed=0)
    assert moved.states.p_value == moved.actions.p_value == 0.001
    assert min(same.states.p_value, same.actions.p_value) > 0.01
    assert moved.states.effect > 1 > same.states.effect
    assert moved.actions.distance > 3 * same.actions.distance
    assert moved.states.distance > 3 * same.states.distance


def test_distances_are_those_of_the_scaled_states_and_means_those_of_the_episodes():
    of = noise(0.5)
    result = measure("world", *summed(of), seed=0)
    episodes = [of.play(seed) for seed in range(40)]
    states = np.array([each.states for each in episodes])
    low, high = states.min(axis=(0, 1))[:2], states.max(axis=(0, 1))[:2]
    scaled = (states[..., :2] - low) / (high - low)
    even, odd = scaled[::2].reshape(-1, 2), scaled[1::2].reshape(-1, 2)
    expected = [wasserstein_distance(even[:, i], odd[:, i]) for i in range(2)]
    assert result.state_distances == pytest.approx([*expected, 0], rel=0.05)
    assert result.states.distance == pytest.approx(np.mean(result.state_distances[:2]))
    assert (result.seeds, result.steps, result.average_reward) == (40, 1200, 19.5)
    first = states[:, 0]
    pairs = [abs(first[i] - first[j]).sum() for i in range(40) for j in range(i)]
    assert result.first_states == pytest.approx(np.mean(pairs))
    assert result.states.two_episodes > result.states.distance


def test_holms_correction_is_over_all_environments_actions_and_states():
    results = [measure(name, *summed(noise(s)), seed=0) for name, s in (("a", 1.0), ("b", 0.0))]
    moved, same = corrected(results)
    assert moved.states.holm == pytest.approx(0.004)
    assert moved.actions.holm == pytest.approx(0.004)
    assert same.states.holm >= same.states.p_value

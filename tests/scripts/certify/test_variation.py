"""What tells two halves of the seeds apart is measured right, from counts alone."""

from __future__ import annotations

import numpy as np
import pytest
from environments.environment import Environment, Trajectory
from environments.summaries import Discretisation, Summary
from environments.variation import corrected, measure
from scipy.stats import wasserstein_distance


def noise(shift: float = 0, *, discrete: bool = True) -> Environment:
    """Return an environment of noise; that of odd seeds is elsewhere, by `shift`."""

    def play(seed: int) -> Trajectory:
        rng = np.random.default_rng(seed)
        moved = shift * (seed % 2)
        states = np.stack(
            [rng.normal(moved, size=31), rng.integers(0, 5 + 2 * moved, 31), np.full(31, 7)], axis=1
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


@pytest.mark.parametrize("discrete", [True, False])
def test_other_points_have_another_fingerprint(discrete):
    first, again, other = (summed(noise(s, discrete=discrete), 4)[0] for s in (0, 0, 0.1))
    assert first.fingerprint == again.fingerprint != other.fingerprint


def test_visits_are_told_apart_by_the_half_of_the_seed():
    of = noise()
    discretisation, summary = summed(of)
    for half in (0, 1):
        places = np.concatenate([of.play(seed).states[:, 1::-1] for seed in range(half, 40, 2)])
        expected = np.histogramdd(places, (discretisation.up, discretisation.across))[0]
        assert np.array_equal(summary.visits[half], expected)


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
    discretisation, summary = summed(of)
    result = measure("world", discretisation, summary, seed=0)
    episodes = [of.play(seed) for seed in range(40)]
    states = np.array([each.states for each in episodes])
    low, high = states.min(axis=(0, 1))[:2], states.max(axis=(0, 1))[:2]
    scaled = (states[..., :2] - low) / (high - low)
    even, odd = scaled[::2].reshape(-1, 2), scaled[1::2].reshape(-1, 2)
    real, whole = (wasserstein_distance(even[:, i], odd[:, i]) for i in range(2))
    assert result.state_distances == (pytest.approx(real, rel=0.02), pytest.approx(whole), 0)
    assert result.states.distance == pytest.approx(np.mean(result.state_distances[:2]))
    assert (result.seeds, result.steps, result.average_reward) == (40, 1200, 19.5)
    assert summary.counts[:, :3].sum() == result.steps
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

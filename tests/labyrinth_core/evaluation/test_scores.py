"""The figures of a policy and of the baselines: what follows from episodes and their actions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.labyrinths_of_datasets import CONFIGS
from support.policies import Table, mistaken

from labyrinth_core import load_arrays
from labyrinth_core.evaluation import KnownDataset, Player, baselines
from labyrinth_core.evaluation.scores import Episodes, Scores
from labyrinth_core.world import RULES


@pytest.mark.parametrize("config", CONFIGS.values())
@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
def test_a_success_rate_asks_the_policy_only_where_its_episodes_go(datasets, config, share):
    arrays = load_arrays(datasets, config, "train", image_size=12)
    actions, asked = mistaken(arrays, share), 0
    expected = Player.of(Table(arrays, actions)).score(arrays).sr

    def policy(observations):
        nonlocal asked
        asked += len(observations)
        return Table(arrays, actions)(observations)

    assert Player.of(policy).success_rate(arrays) == expected
    visited = set()
    for state in arrays.initial.tolist():
        while not arrays.terminal[state] and state not in visited:
            visited.add(state)
            state = arrays.next_state[state, actions[state]]
    assert asked == len(visited)


@pytest.mark.parametrize("cells", [9, 12, 16, 25, 100, 899])
def test_the_step_limit_costs_exactly_four(cells):
    episodes = Episodes.of_letters(["lwc"], [[40 * cells] * 3], cells)
    assert episodes.returns.tolist() == [[-4, -4, -4]]


@pytest.mark.parametrize("share", [0.0, 0.2, 0.5])
def test_aer_is_what_sr_and_the_return_of_the_solved_imply(datasets, share):
    arrays = load_arrays(datasets, "3x4", "test", image_size=8)
    scores = Player.of(Table(arrays, mistaken(arrays, share))).score(arrays)
    returns = scores.episodes.returns
    solved = returns[scores.episodes.solved].mean() if scores.sr else 0.0
    assert scores.aer == pytest.approx(scores.sr * solved + (1 - scores.sr) * -4)
    told = scores.figures()
    assert told["aer_std"] == pytest.approx(np.sqrt(np.mean((returns - scores.aer) ** 2)))
    assert told["sr_interval"][0] <= scores.sr <= told["sr_interval"][1]
    assert sum(told["failures"].values()) == round((1 - scores.sr) * 5)
    moves = np.atleast_2d(scores.episodes.moves).tolist()
    again = Episodes.of_letters(scores.episodes.letters, moves, arrays.cells)
    assert again.returns.tolist() == [returns.tolist()]


def test_several_episodes_of_one_policy_are_averaged_in_its_interval(datasets):
    arrays = load_arrays(datasets, "3x4", "test", image_size=8)
    scores = Player.of(Table(arrays, mistaken(arrays, 0.2))).score(arrays)
    both = Episodes(
        *(np.tile(getattr(scores.episodes, name), (2, 1)) for name in ("outcomes", "moves")),
        arrays.cells,
    )
    twice = replace(scores, episodes=both).figures()
    for name in ("sr_interval", "aer_interval"):
        assert twice[name] == scores.figures()[name]


def test_accuracy_counts_any_optimal_action_where_there_is_one(datasets):
    arrays = load_arrays(datasets, "3x4-icy_floor", "validation", image_size=8)
    best = np.array([np.flatnonzero(row)[-1] if row.any() else 0 for row in arrays.optimal])
    scores = Player.of(Table(arrays, best)).score(arrays)
    assert (scores.accuracy_on_demonstrations, scores.accuracy_elsewhere) == (1, 1)
    assert scores.path_efficiency == 1
    worst = np.array([np.flatnonzero(~row)[0] if not row.all() else 0 for row in arrays.optimal])
    wrong = Player.of(Table(arrays, worst)).score(arrays)
    assert wrong.accuracy_on_demonstrations < 0.5
    assert (wrong.sr, wrong.path_efficiency) == (0, None)


def test_long_ways_and_failures_count_less_weighted_by_path_length():
    episodes = Episodes.of_letters(["sssli"], [[4, 8, 16, 360, 4]], 9)
    known = np.array([True, True, False, False, False])
    scores = Scores(episodes, np.arange(5), np.full(5, 4), None, None, known)
    assert scores.spl == pytest.approx((1 + 0.5 + 0.25) / 5)
    assert scores.path_efficiency == pytest.approx((1 + 0.5 + 0.25) / 3)
    assert scores.sr == 0.6
    assert scores.sr_within_cells == 0.4  # Nine cells, so of the solved not that in 16 moves.
    assert (scores.sr_known_route, scores.sr_new_route) == (1, pytest.approx(1 / 3))
    assert scores.figures()["known_route"] == "11000"
    nowhere = replace(scores, known_route=np.zeros(5, np.bool_))
    assert (nowhere.sr_known_route, nowhere.sr_new_route) == (None, 0.6)
    unasked = replace(scores, known_route=None).figures()
    assert {unasked[name] for name in ("sr_known_route", "sr_new_route", "known_route")} == {None}


def baselines_of(datasets, config):
    """Return the figures of all baselines on train."""
    return KnownDataset.read(str(datasets), config).split("train").baselines


def expected_of_random_steps(arrays):
    """Return the figures of uniformly random actions: a step moves a quarter along each action."""
    alive = np.bincount(arrays.initial, minlength=len(arrays.terminal)) / len(arrays.initial)
    solved = within = spl = mean = square = 0
    penalty, limit = RULES.step_penalty / arrays.cells, arrays.step_limit
    for step in range(limit):
        moving = np.repeat(alive / 4, 4).reshape(-1, 4)
        ends = arrays.done & ~arrays.terminal[:, None]
        ending, returns = moving[ends], arrays.rewards[ends] - step * penalty
        distance = np.repeat(arrays.distance[arrays.labyrinth], 4).reshape(-1, 4)[ends]
        goals = arrays.goal[arrays.next_state[ends]]
        solved += ending[goals].sum()
        within += ending[goals].sum() * (step < arrays.cells)
        spl += ending[goals] @ distance[goals] / (step + 1)
        mean, square = mean + ending @ returns, square + ending @ returns**2
        onward = ~arrays.done
        alive = np.bincount(arrays.next_state[onward], moving[onward], len(alive))
    mean -= alive.sum() * limit * penalty
    square += alive.sum() * (limit * penalty) ** 2
    names = ("sr", "sr_within_cells", "spl", "aer", "aer_std")
    return dict(zip(names, (solved, within, spl, mean, (square - mean**2) ** 0.5), strict=True))


@pytest.mark.parametrize("config", CONFIGS.values())
def test_the_random_policy_is_computed_with_each_step_and_without(datasets, config, monkeypatch):
    arrays = load_arrays(datasets, config, "train", observation="vector")
    stepped = baselines_of(datasets, config)["random"]
    expected = expected_of_random_steps(arrays)
    assert stepped == pytest.approx(expected, rel=1e-7)
    assert stepped["sr"] == expected["sr"]  # To the last bit.
    monkeypatch.setattr(baselines, "STEPPED_CELLS", 0)  # As in large labyrinths.
    assert baselines_of(datasets, config)["random"] == pytest.approx(stepped, rel=1e-11)


def test_the_other_baselines_are_what_they_say(datasets):
    arrays, found = (
        load_arrays(datasets, "3x4", "train", image_size=8),
        baselines_of(datasets, "3x4"),
    )
    assert (found["oracle"]["sr"], found["oracle"]["spl"]) == (1, 1)

    def solved_by(route):
        state = arrays.initial
        for action in route.tolist():
            state = arrays.next_state[state, action]
        return arrays.goal[state].sum()

    most = max(map(solved_by, arrays.routes))
    assert most >= 1
    assert found["fixed_path"]["sr"] == pytest.approx(most / 5)
    counts = np.zeros((12, 4), np.int64)
    for state, row in enumerate(arrays.demonstrated):
        counts[arrays.position[state]] += row
    counts[~counts.any(axis=1)] = counts.sum(axis=0)
    majority = Player.of(Table(arrays, counts.argmax(axis=1)[arrays.position])).score(arrays)
    assert found["majority"] == majority.summary()

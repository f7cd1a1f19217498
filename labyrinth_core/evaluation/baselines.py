"""Baselines without learning: random actions, the most frequent action, a fixed route, the optimum.

They give the figures of a policy a scale. They depend on the dataset alone.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from itertools import compress

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.evaluation.following import Episodes, follow
from labyrinth_core.evaluation.labyrinth_arrays import LabyrinthArrays
from labyrinth_core.evaluation.scores import summary_of
from labyrinth_core.world.dynamics import STEP_PENALTY

BASELINES = {
    "random": "uniformly random actions; exact expectations",
    "majority": "in each cell the action that most demonstrations of train take there",
    "fixed_path": "the demonstrated route that solves most of train, walked blindly",
    "oracle": "an optimal action in every state",
}
"""Baseline -> what it does."""


def compare(train: LabyrinthArrays, arrays: LabyrinthArrays) -> dict[str, dict[str, float]]:
    """Return the figures of each baseline on a split; it knows the demonstrations of `train`."""
    return {
        "random": random_figures(arrays),
        "majority": summary_of(follow(arrays, majority_actions(train)[arrays.position]), arrays),
        "fixed_path": summary_of(follow_route(arrays, best_route(train)), arrays),
        "oracle": oracle_figures(arrays),
    }


def majority_actions(train: LabyrinthArrays) -> NDArray[np.int64]:
    """Return the action demonstrated most often in each cell, or in all cells if in it none is."""
    counts = np.zeros((train.cells, 4), np.int64)
    np.add.at(counts, train.position, train.demonstrated)
    unseen = counts.sum(axis=1) == 0
    counts[unseen] = counts.sum(axis=0)
    actions: NDArray[np.int64] = counts.argmax(axis=1)
    return actions


def best_route(train: LabyrinthArrays) -> tuple[int, ...]:
    """Return the demonstrated route, of the 500 most frequent, that solves most labyrinths.

    Of routes in pieces it is one of the first pieces.
    """
    from_start = np.isin(train.route_starts, train.initial).tolist()
    counts = Counter(tuple(route.tolist()) for route in compress(train.routes, from_start))
    routes = [route for route, _ in counts.most_common(500)]
    return max([*routes, ()], key=lambda route: follow_route(train, route).solved.sum())


def follow_route(arrays: LabyrinthArrays, route: Sequence[int]) -> Episodes:
    """Return the results of the episodes in which the agent takes one route in every labyrinth.

    After the last action it stays where it is until the episode is cut.
    """
    state = arrays.initial
    moves = np.zeros(len(state), np.int64)
    for action in route:
        moves += ~arrays.terminal[state]
        state = arrays.next_state[state, action]
    ended = arrays.terminal[state]
    outcomes = np.select([arrays.goal[state], ended], ["solved", "ice"], "cut")
    return Episodes(outcomes, np.where(ended, moves, arrays.step_limit), arrays.cells)


def oracle_figures(arrays: LabyrinthArrays) -> dict[str, float]:
    """Return the figures of an optimal action in every state."""
    return summary_of(follow(arrays, arrays.optimal.argmax(axis=1)), arrays)


def random_figures(arrays: LabyrinthArrays) -> dict[str, float]:
    """Return the exact expectations of uniformly random actions.

    The distribution over the states is propagated step by step up to the limit; probability that
    reaches a terminal state leaves it, with the return of that step.
    """
    count, labyrinths = arrays.next_state.shape[0], len(arrays.initial)
    here = np.repeat(np.arange(count), 4)
    onward, ends = ~arrays.done.ravel(), arrays.done.ravel() & ~arrays.terminal[here]
    sources, targets = here[onward], arrays.next_state.ravel()[onward]
    last, paid = here[ends], arrays.rewards.ravel()[ends].astype(np.float64)
    penalty = STEP_PENALTY / arrays.cells
    goals = paid > 0
    distance = arrays.distance[arrays.labyrinth[last[goals]]]
    alive = np.bincount(arrays.initial, np.full(labyrinths, 1 / labyrinths), count)
    solved = within = spl = mean = square = 0.0
    for step in range(arrays.step_limit):
        ending, returns = alive[last] / 4, paid - penalty * step
        reaching = ending[goals]
        solved += float(reaching.sum())
        within += float(reaching.sum()) if step < arrays.cells else 0.0
        spl += float(reaching @ distance) / (step + 1)
        mean += float(ending @ returns)
        square += float(ending @ returns**2)
        alive = np.bincount(targets, alive[sources] / 4, count)
    left, cut = float(alive.sum()), -penalty * arrays.step_limit
    mean, square = mean + left * cut, square + left * cut**2
    deviation = max(square - mean**2, 0.0) ** 0.5
    figures = {"sr": solved, "sr_within_cells": within, "spl": spl}
    return figures | {"aer": mean, "aer_std": deviation}

"""Baselines that need no learning, to compare the figures of a policy with.

Random actions and the optimum depend on the labyrinths alone. The other baselines know the
demonstrations of train: two act blindly, and two see the walls of the current labyrinth. None of
them generalises.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.evaluation.labyrinth_arrays import LabyrinthArrays
from labyrinth_core.evaluation.playing import Episodes, follow, follow_route
from labyrinth_core.evaluation.scores import Scores
from labyrinth_core.world import RULES, RouteMemory

BASELINES = {
    "random": "uniformly random actions; exact expectations",
    "majority": "in each cell the action that most demonstrations of train take there",
    "fixed_path": "the demonstrated route that solves most of train, walked blindly",
    "oracle": "an optimal action in every state",
}
"""Baseline -> what it does."""

BLIND = ("majority", "fixed_path")
"""The baselines that do not look at a labyrinth."""

REFERENCES = {
    "route_memory": "the shortest demonstrated way of train that is open here, if one is",
    "local_walls": "what train does most often in the same cell with the same walls around it",
}
"""Reference -> what it does."""

SIDES = 1 << np.arange(4)
"""The bit for a wall on each of the four sides of a cell, in the number of its surroundings."""
SURROUNDINGS = 16


@dataclass(frozen=True, eq=False)
class TrainMemory:
    """What the references and the blind baselines remember of train."""

    train: LabyrinthArrays
    routes: RouteMemory
    """The demonstrated routes."""
    actions: NDArray[np.int64]
    """The action demonstrated most often in each cell, by its surroundings, shape (cells, 16)."""

    @classmethod
    def of(cls, train: LabyrinthArrays) -> TrainMemory:
        """Return the memory of a split's demonstrations.

        For surroundings that no demonstration meets in a cell, `actions` has the most frequent
        action in the same surroundings elsewhere; for those met nowhere, the most frequent of all.
        """
        begun = zip(train.route_starts.tolist(), train.routes, strict=True)
        routes = RouteMemory(_visited(train, start, route) for start, route in begun)
        counts = np.zeros((train.cells, SURROUNDINGS, 4), np.int64)
        np.add.at(counts, (train.position, surroundings(train)), train.demonstrated)
        for wider in (counts.sum(axis=0), counts.sum(axis=(0, 1))):
            counts = np.where(counts.any(axis=2, keepdims=True), counts, wider)
        return cls(train, routes, counts.argmax(axis=2))

    @cached_property
    def majority(self) -> NDArray[np.int64]:
        """The action demonstrated most often in each cell; for unvisited cells, in all cells."""
        counts = np.zeros((self.train.cells, 4), np.int64)
        np.add.at(counts, self.train.position, self.train.demonstrated)
        unseen = counts.sum(axis=1) == 0
        counts[unseen] = counts.sum(axis=0)
        actions: NDArray[np.int64] = counts.argmax(axis=1)
        return actions

    @cached_property
    def best_route(self) -> tuple[int, ...]:
        """The demonstrated route, of the 500 most frequent, that solves most labyrinths.

        Cached, since finding it takes 50 ms with 100 labyrinths and 0.5 s with 1,000, and up to 19
        splits need it.
        """
        train = self.train
        counts = Counter(tuple(route.tolist()) for route in train.routes)
        routes = [route for route, _ in counts.most_common(500)]
        return max([*routes, ()], key=lambda route: follow_route(train, route).solved.sum())

    def figures(
        self, arrays: LabyrinthArrays, *, blind: bool = False
    ) -> tuple[NDArray[np.bool_], dict[str, dict[str, float]]]:
        """Return which labyrinths have a remembered shortest route, and each baseline's figures.

        The first has shape (L,). The baselines in `BLIND` are included only with `blind`.
        """
        walked = self.walk(arrays)
        known: NDArray[np.bool_] = walked.moves == arrays.distance
        usual = self.actions[arrays.position, surroundings(arrays)]
        figures = {
            "route_memory": Scores.of(walked, arrays).summary(),
            "local_walls": Scores.of(follow(arrays, usual), arrays).summary(),
            "random": random_figures(arrays),
            "oracle": Scores.of(follow(arrays, arrays.optimal.argmax(axis=1)), arrays).summary(),
        }
        if blind:
            majority = follow(arrays, self.majority[arrays.position])
            fixed_path = follow_route(arrays, self.best_route)
            figures["majority"] = Scores.of(majority, arrays).summary()
            figures["fixed_path"] = Scores.of(fixed_path, arrays).summary()
        return known, figures

    def walk(self, arrays: LabyrinthArrays) -> Episodes:
        """Return the episodes of an agent that follows remembered routes, and stays without one."""
        ways = [self.routes.best(labyrinth) for labyrinth in arrays.labyrinths]
        moves = [arrays.step_limit if way is None else len(way) for way in ways]
        outcomes = np.array(["cut" if way is None else "solved" for way in ways])
        return Episodes(outcomes, np.array(moves, np.int64), arrays.cells)


def _visited(arrays: LabyrinthArrays, state: int, route: NDArray[np.int64]) -> list[int]:
    """Return the cells that the agent visits on a route that begins in `state`."""
    states = [state]
    for action in route.tolist():
        states.append(int(arrays.next_state[states[-1], action]))
    cells: list[int] = arrays.position[states].tolist()
    return cells


def surroundings(arrays: LabyrinthArrays) -> NDArray[np.int64]:
    """Return a bit set per state of the sides with a wall or a locked door, shape (S,)."""
    blocked = arrays.next_state == np.arange(len(arrays.next_state))[:, None]
    numbers: NDArray[np.int64] = blocked @ SIDES
    return numbers


def random_figures(arrays: LabyrinthArrays) -> dict[str, float]:
    """Return the exact expectations of uniformly random actions.

    No episode is played: the distribution over the states is propagated step by step up to the
    limit; probability that reaches a terminal state is removed, with the return of that step.
    """
    count, labyrinths = arrays.next_state.shape[0], len(arrays.initial)
    here = np.repeat(np.arange(count), 4)
    onward, ends = ~arrays.done.ravel(), arrays.done.ravel() & ~arrays.terminal[here]
    before = _before(here[onward], arrays.next_state.ravel()[onward], count)
    last, paid = here[ends], arrays.rewards.ravel()[ends].astype(np.float64)
    penalty = RULES.step_penalty / arrays.cells
    goals = paid > 0
    distance = arrays.distance[arrays.labyrinth[last[goals]]]
    begun = np.bincount(arrays.initial, np.full(labyrinths, 1 / labyrinths), count)
    alive = begun.astype(np.float64)  # Weighted counts are floats; NumPy declares whole numbers.
    moving, onto = np.zeros(count + 1), np.empty(count)
    solved = within = spl = mean = square = 0.0
    for step in range(arrays.step_limit):
        ending, returns = alive[last] / 4, paid - penalty * step
        reaching = ending[goals]
        solved += float(reaching.sum())
        within += float(reaching.sum()) if step < arrays.cells else 0.0
        spl += float(reaching @ distance) / (step + 1)
        mean += float(ending @ returns)
        square += float(ending @ returns**2)
        np.divide(alive, 4, out=moving[:-1])
        moving.take(before[0], out=alive, mode="clip")
        for sources in before[1:]:
            alive += moving.take(sources, out=onto, mode="clip")
    left, cut = float(alive.sum()), -penalty * arrays.step_limit
    mean, square = mean + left * cut, square + left * cut**2
    deviation = max(square - mean**2, 0.0) ** 0.5
    figures = {"sr": solved, "sr_within_cells": within, "spl": spl}
    return figures | {"aer": mean, "aer_std": deviation}


def _before(
    sources: NDArray[np.int64], targets: NDArray[np.int64], count: int
) -> NDArray[np.int64]:
    """Return the sources of the moves to each of `count` states, a row for each move of a state.

    Adding what comes along the rows in turn takes half the time of `np.bincount`, and gives the
    same sums to the bit. Where a state has fewer moves, the source is `count`.
    """
    moves = np.bincount(targets, minlength=count)
    order = np.argsort(targets, kind="stable")
    place = np.arange(len(order)) - np.repeat(np.cumsum(moves) - moves, moves)
    before = np.full((max(moves.max(initial=0), 1), count), count)
    before[place, targets[order]] = sources[order]
    return before

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
from labyrinth_core.evaluation.playing import follow, follow_route
from labyrinth_core.evaluation.scores import Episodes, Scores
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

REPLANNERS = ("replanner", "without memory")
"""The names of the replanner's figures, with memory and without; see `replanner`."""

WITHOUT_LEARNING = (*BASELINES, *REFERENCES, *REPLANNERS)
"""The names of all figures that need no learning, in the order of the columns of tables."""

SIDES = 1 << np.arange(4)
"""The bit for a wall on each of the four sides of a cell, in the number of its surroundings."""
SURROUNDINGS = 16

STEPPED_CELLS = 625
"""In labyrinths of at most so many cells, 25x25, random actions are followed one step at a time.

The number of steps and their cost grow with the cells: 100 labyrinths of 100x100 would take hours.
"""


@dataclass(frozen=True, eq=False)
class TrainMemory:
    """What the references and the blind baselines remember of train."""

    train: LabyrinthArrays
    routes: RouteMemory
    """The demonstrated routes."""
    actions: NDArray[np.int64]
    """The action demonstrated most often in each cell, by its surroundings, shape (cells, 16)."""
    majority: NDArray[np.int64]
    """The action demonstrated most often in each cell, shape (cells,); for unvisited cells, in all
    cells."""

    @classmethod
    def of(cls, train: LabyrinthArrays) -> TrainMemory:
        """Return the memory of a split's demonstrations.

        For surroundings that no demonstration meets in a cell, `actions` has the most frequent
        action in the same surroundings elsewhere; for those met nowhere, the most frequent of all.
        """
        walked = train.walk(train.route_starts, train.routes)
        routes = RouteMemory(train.position[states].tolist() for states in walked)
        counts = np.zeros((train.cells, SURROUNDINGS, 4), np.int64)
        np.add.at(counts, (train.position, surroundings(train)), train.demonstrated)
        by_cell, overall = counts.sum(axis=1), counts.sum(axis=(0, 1))
        by_cell = np.where(by_cell.any(axis=1, keepdims=True), by_cell, overall)
        for wider in (counts.sum(axis=0), overall):
            counts = np.where(counts.any(axis=2, keepdims=True), counts, wider)
        return cls(train, routes, counts.argmax(axis=2), by_cell.argmax(axis=1))

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
        ways: list[list[int] | None] = [None] * len(arrays.labyrinths)
        # By their starts, as the ways on from a cell are remembered for one cell at a time.
        for place in np.argsort(arrays.position[arrays.initial], kind="stable").tolist():
            labyrinth = arrays.labyrinths[place]
            ways[place] = self.routes.best(labyrinth)
            labyrinth.structure.free()
        moves = [arrays.step_limit if way is None else len(way) for way in ways]
        outcomes = np.array(["cut" if way is None else "solved" for way in ways])
        return Episodes(outcomes, np.array(moves, np.int64), arrays.cells)


def surroundings(arrays: LabyrinthArrays) -> NDArray[np.int64]:
    """Return a bit set per state of the sides with a wall or a locked door, shape (S,)."""
    blocked = arrays.next_state == np.arange(len(arrays.next_state))[:, None]
    numbers: NDArray[np.int64] = blocked @ SIDES
    return numbers


def random_figures(arrays: LabyrinthArrays) -> dict[str, float]:
    """Return the exact expectations of uniformly random actions.

    No episode is played: the distribution over the states is propagated up to the step limit, and
    probability that reaches a terminal state is removed, with the return of that step.
    """
    walk = _RandomWalk.of(arrays)
    if arrays.cells > STEPPED_CELLS:
        return _unstepped_figures(walk, arrays)
    penalty = RULES.step_penalty / arrays.cells
    solved = within = spl = mean = square = 0.0
    alive = walk.begun.copy()
    for step in range(arrays.step_limit):
        ending, returns = alive[walk.last] / 4, walk.paid - penalty * step
        reaching = ending[walk.goals]
        solved += float(reaching.sum())
        within += float(reaching.sum()) if step < arrays.cells else 0.0
        spl += float(reaching @ walk.distance) / (step + 1)
        mean += float(ending @ returns)
        square += float(ending @ returns**2)
        alive = walk.moved(alive, out=alive)
    unfinished, cut = float(alive.sum()), -penalty * arrays.step_limit
    return _figures(solved, within, spl, mean + unfinished * cut, square + unfinished * cut**2)


def _figures(
    solved: float, within: float, spl: float, mean: float, square: float
) -> dict[str, float]:
    """Return the figures of a baseline, given the means of the return and of its square."""
    deviation = max(square - mean**2, 0.0) ** 0.5
    figures = {"sr": solved, "sr_within_cells": within, "spl": spl}
    return figures | {"aer": mean, "aer_std": deviation}


def _unstepped_figures(walk: _RandomWalk, arrays: LabyrinthArrays) -> dict[str, float]:
    """Return what `random_figures` returns, from some 9 sqrt(T) instead of T steps.

    After t steps the distribution is P^t times the first one. The power x^t is a sum of Chebyshev
    polynomials T_k(x), of which those of a degree above 9 sqrt(t) have weights that add up to less
    than 10^-16; T_k(P) times the distribution follows from the two before it. P is symmetric, but
    for steps that pick up a key or open a door, so that none of them grows.
    """
    limit, cells, penalty = arrays.step_limit, arrays.cells, RULES.step_penalty / arrays.cells
    steps = np.arange(limit)
    weightings = np.stack([np.ones(limit), steps < cells, 1 / (steps + 1), steps, steps**2.0])
    weights = _chebyshev(weightings, min(limit, round(9 * limit**0.5)))
    before, now = walk.moved(walk.begun), walk.begun  # T_1 = T_-1
    sums = np.empty((3, weights.shape[1]))
    for degree in range(weights.shape[1]):
        ending = now[walk.last] / 4
        reaching = ending[walk.goals]
        sums[:, degree] = reaching.sum(), reaching @ walk.distance, ending[~walk.goals].sum()
        before, now = now, 2 * walk.moved(now) - before
    reached, shares, iced = sums @ weights.T
    left, cut = 1 - reached[0] - iced[0], -penalty * limit
    mean, square = left * cut, left * cut**2
    for reward, (all_steps, *_, times_step, times_square) in (
        (RULES.goal_reward, reached),
        (RULES.ice_reward, iced),
    ):
        mean += reward * all_steps - penalty * times_step
        square += reward**2 * all_steps - 2 * reward * penalty * times_step
        square += penalty**2 * times_square
    return _figures(*map(float, (reached[0], reached[1], shares[2], mean, square)))


def _chebyshev(weightings: NDArray[np.float64], degree: int) -> NDArray[np.float64]:
    """Return polynomials as sums of Chebyshev polynomials, shape (polynomials, degree + 1).

    Args:
        weightings: The weight of each power of x from 0 on, shape (polynomials, powers).
        degree: The degree at which the sums are cut.
    """
    power = np.zeros(degree + 2)
    power[0] = 1
    found = np.zeros((len(weightings), degree + 1))
    together = 256
    for begin in range(0, weightings.shape[1], together):
        some = weightings[:, begin : begin + together]
        powers = np.empty((some.shape[1], degree + 1))
        for row in powers:
            row[:] = power[:-1]
            # x T_k = (T_(k-1) + T_(k+1)) / 2, and x T_0 = T_1.
            halves = power / 2
            power[:-1] = halves[1:]
            power[-1] = 0
            power[1:-1] += halves[:-2]
            power[1] += halves[0]
        found += some @ powers
    return found


@dataclass(frozen=True, eq=False)
class _RandomWalk:
    """Where uniformly random actions lead in all labyrinths at once; of E moves that end it."""

    begun: NDArray[np.float64]
    """The probability of each state at first, shape (S,); their sum is 1."""
    last: NDArray[np.int64]
    """The state in which each move that ends an episode is made, shape (E,)."""
    paid: NDArray[np.float64]
    """The reward of these moves, shape (E,)."""
    goals: NDArray[np.bool_]
    """Whether they reach a goal, shape (E,)."""
    distance: NDArray[np.int64]
    """The moves on a shortest route in the labyrinths of those that do, shape (goals,)."""
    before: NDArray[np.int64]
    """The states from which the other moves lead to each state, as in `_before`."""
    scratch: tuple[NDArray[np.float64], NDArray[np.float64]]
    """Memory for `moved`, shapes (S + 1,), whose last is 0, and (S,)."""

    @classmethod
    def of(cls, arrays: LabyrinthArrays) -> _RandomWalk:
        """Return the walk in a split's labyrinths, in each with the same probability."""
        count, labyrinths = arrays.next_state.shape[0], len(arrays.initial)
        here = np.repeat(np.arange(count), 4)
        onward, ends = ~arrays.done.ravel(), arrays.done.ravel() & ~arrays.terminal[here]
        before = _before(here[onward], arrays.next_state.ravel()[onward], count)
        last, paid = here[ends], arrays.rewards.ravel()[ends].astype(np.float64)
        goals = paid > 0
        distance = arrays.distance[arrays.labyrinth[last[goals]]]
        begun = np.bincount(arrays.initial, np.full(labyrinths, 1 / labyrinths), count)
        # Weighted counts are floats; NumPy declares whole numbers.
        scratch = np.zeros(count + 1), np.empty(count)
        return cls(begun.astype(np.float64), last, paid, goals, distance, before, scratch)

    def moved(
        self, alive: NDArray[np.float64], out: NDArray[np.float64] | None = None
    ) -> NDArray[np.float64]:
        """Return what a step makes of a distribution over states, without what ends in it."""
        moving, onto = self.scratch
        np.divide(alive, 4, out=moving[:-1])
        after = moving.take(self.before[0], out=out, mode="clip")
        for sources in self.before[1:]:
            after += moving.take(sources, out=onto, mode="clip")
        return after


def _before(
    sources: NDArray[np.int64], targets: NDArray[np.int64], count: int
) -> NDArray[np.int64]:
    """Return the sources of the moves to each of `count` states, a row for each move of a state.

    Adding what comes along the rows in turn takes half the time of `np.bincount`, and gives the
    same sums to the bit. Where a state has fewer moves, the source is `count`.
    """
    moves = np.bincount(targets, minlength=count)
    order = np.argsort(targets, kind="stable")
    row = np.arange(len(order)) - np.repeat(np.cumsum(moves) - moves, moves)
    before = np.full((max(moves.max(initial=0), 1), count), count)
    before[row, targets[order]] = sources[order]
    return before

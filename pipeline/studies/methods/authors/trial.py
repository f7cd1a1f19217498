"""How the authors' code tries a policy: on rows, and in episodes that are cut where they repeat."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.evaluation.labyrinth_arrays import LabyrinthArrays
from labyrinth_core.evaluation.playing import Episodes, play
from pipeline.training.methods.acting import draw

VISITS = 5
"""An episode is cut where the agent comes to a state in which it has acted so often already."""


class Rows(NamedTuple):
    """The N rows of a split: those of `Steps`, and the last state of each episode."""

    states: NDArray[np.int64]
    """Shape (N,)."""
    actions: NDArray[np.int64]
    """The action of the row, shape (N,): in a last row that of the row before it."""


def rows_of(arrays: LabyrinthArrays) -> Rows:
    """Return the rows of all episodes of a split, in order."""
    states, actions = [], []
    for start, route in zip(arrays.route_starts.tolist(), arrays.routes, strict=True):
        states.append(start)
        for action in route.tolist():
            states.append(int(arrays.next_state[states[-1], action]))
        actions += [*route.tolist(), int(route[-1])]
    return Rows(np.array(states), np.array(actions))


def certain(actions: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return the probabilities, shape (S, 4), of a policy that takes one action in each state."""
    return np.eye(4)[actions]


def accuracy(
    arrays: LabyrinthArrays, probabilities: NDArray[np.float64], rng: np.random.Generator
) -> float:
    """Return how often a policy's action, drawn once for each row, is that of the row."""
    rows = rows_of(arrays)
    return float((draw(probabilities[rows.states], rng) == rows.actions).mean())


def try_out(
    arrays: LabyrinthArrays,
    probabilities: NDArray[np.float64],
    rng: np.random.Generator,
    visits: int | None = VISITS,
) -> tuple[Episodes, NDArray[np.int64]]:
    """Let a policy act for one episode in each labyrinth.

    Args:
        arrays: The labyrinths.
        probabilities: The probability of each action in each state, shape (S, 4).
        rng: Draws the actions.
        visits: An episode is cut, and counts like one that reached the step limit, where the agent
            comes to a state in which it has acted so often; None for the step limit alone.

    Returns:
        The results, and all steps, as rows of s, a, s', shape (N, 3).
    """
    taken = [np.zeros((0, 3), np.int64)]

    def choose(state: NDArray[np.int64], running: NDArray[np.int64]) -> NDArray[np.int64]:
        here = state[running]
        actions = draw(probabilities[here], rng)
        taken.append(np.stack([here, actions, arrays.next_state[here, actions]], axis=1))
        return actions

    return play(arrays, choose, visits=visits), np.concatenate(taken)

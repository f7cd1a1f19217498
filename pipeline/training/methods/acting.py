"""Acting in all training labyrinths at once, by look-up: what a policy does is known as a table."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from labyrinth_core.evaluation.labyrinth_arrays import LabyrinthArrays


class Walk(NamedTuple):
    """T steps of N walkers, each array of shape (T, N)."""

    states: NDArray[np.int64]
    actions: NDArray[np.int64]
    next_states: NDArray[np.int64]
    """Where the action led; a walker whose episode is over begins anew after that."""
    over: NDArray[np.bool_]
    """Whether the episode was over then: at its end, or cut at the step limit."""
    done: NDArray[np.bool_]
    """Whether it ended, on the goal or on ice."""


def softmax(scores: Tensor) -> NDArray[np.float64]:
    """Return probabilities, shape (S, 4), in double precision so that they add up to 1."""
    table: NDArray[np.float64] = torch.softmax(scores.double(), 1).cpu().numpy()
    return table


def draw(probabilities: NDArray[np.float64], rng: np.random.Generator) -> NDArray[np.int64]:
    """Return one class for each row of probabilities, shape (N,)."""
    below = np.cumsum(probabilities[:, :-1], axis=1) <= rng.random((len(probabilities), 1))
    drawn: NDArray[np.int64] = below.sum(axis=1)
    return drawn


def walk(
    worlds: LabyrinthArrays,
    probabilities: NDArray[np.float64],
    where: NDArray[np.int64],
    taken: NDArray[np.int64],
    steps: int,
    rng: np.random.Generator,
) -> Walk:
    """Let one walker in each labyrinth go on, and from the start when its episode is over.

    Args:
        worlds: The labyrinths.
        probabilities: Of the actions in each state, shape (S, 4).
        where: The state each walker is in, shape (L,); changed in place.
        taken: Steps it took in its episode, shape (L,); changed in place.
        steps: How many each takes.
        rng: Draws the actions.
    """
    rows = []
    for _ in range(steps):
        states = where.copy()
        actions = draw(probabilities[states], rng)
        after = worlds.next_state[states, actions]
        done = worlds.done[states, actions]
        taken += 1
        over = done | (taken >= worlds.step_limit)
        where[:] = np.where(over, worlds.initial, after)
        taken[over] = 0
        rows.append(Walk(states, actions, after, over, done))
    return Walk(*map(np.stack, zip(*rows, strict=True)))

"""Acting in all training labyrinths in lock-step, by look-up in a table of action probabilities."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from labyrinth_core.evaluation.labyrinth_arrays import LabyrinthArrays


class Rollout(NamedTuple):
    """T steps of N agents, each array of shape (T, N)."""

    states: NDArray[np.int64]
    actions: NDArray[np.int64]
    next_states: NDArray[np.int64]
    """The state that the action led to; where the episode is over, the next one begins after it."""
    over: NDArray[np.bool_]
    """Whether the step was the last of its episode: terminated, or truncated at the step limit."""
    done: NDArray[np.bool_]
    """Whether the episode terminated, on the goal or on ice."""

    @property
    def transitions(self) -> NDArray[np.int64]:
        """The steps as rows of s, a, s', shape (T * N, 3)."""
        return np.stack([self.states, self.actions, self.next_states], axis=2).reshape(-1, 3)


def softmax(scores: Tensor) -> NDArray[np.float64]:
    """Return probabilities, shape (S, 4), in double precision so that they add up to 1."""
    table: NDArray[np.float64] = torch.softmax(scores.double(), 1).cpu().numpy()
    return table


def draw(probabilities: NDArray[np.float64], rng: np.random.Generator) -> NDArray[np.int64]:
    """Return one class drawn from each row of probabilities, shape (N,)."""
    below = np.cumsum(probabilities[:, :-1], axis=1) <= rng.random((len(probabilities), 1))
    drawn: NDArray[np.int64] = below.sum(axis=1)
    return drawn


def roll_out(
    arrays: LabyrinthArrays,
    probabilities: NDArray[np.float64],
    where: NDArray[np.int64],
    taken: NDArray[np.int64],
    steps: int,
    rng: np.random.Generator,
) -> Rollout:
    """Let one agent in each labyrinth act, beginning a new episode whenever one is over.

    Args:
        arrays: The labyrinths.
        probabilities: The probability of each action in each state, shape (S, 4).
        where: The state that each agent is in, shape (L,); changed in place.
        taken: The number of steps of each agent's current episode, shape (L,); changed in place.
        steps: The number of steps that each agent takes.
        rng: Draws the actions.
    """
    rows = []
    for _ in range(steps):
        states = where.copy()
        actions = draw(probabilities[states], rng)
        after = arrays.next_state[states, actions]
        done = arrays.done[states, actions]
        taken += 1
        over = done | (taken >= arrays.step_limit)
        where[:] = np.where(over, arrays.initial, after)
        taken[over] = 0
        rows.append(Rollout(states, actions, after, over, done))
    return Rollout(*map(np.stack, zip(*rows, strict=True)))

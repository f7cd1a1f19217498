"""A labyrinth as arrays over its numbered states, so that a step is a look-up."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.world.dynamics import (
    State,
    initial,
    is_terminal,
    normalised_goal_reward,
    reward,
    state_count,
    state_index,
    transition_table,
)
from labyrinth_core.world.labyrinth import Labyrinth
from labyrinth_core.world.solver import distances, optimal_actions


@dataclass(frozen=True, eq=False)
class LabyrinthTables:
    """All that an environment says of a labyrinth, worked out once; arrays are read-only."""

    labyrinth: Labyrinth
    initial: int
    """Number of the state an episode begins in."""
    transitions: NDArray[np.int32]
    """Number of the state that each action leads to, shape (states, 4)."""
    rewards: NDArray[np.float64]
    """What a step that leads to the state pays, shape (states,)."""
    terminal: NDArray[np.bool_]
    """Whether the episode ends in the state, shape (states,)."""
    distances: NDArray[np.int64]
    """Least moves to the goal, -1 where no way leads there, shape (states,)."""
    optimal_actions: NDArray[np.bool_]
    """Which actions begin a shortest route, shape (states, 4)."""


def tabulate(labyrinth: Labyrinth, *, normalised: bool = False) -> LabyrinthTables:
    """Return the tables of a labyrinth.

    Args:
        labyrinth: What to tabulate.
        normalised: Whether the goal pays so much that an optimal episode returns exactly 1.
    """
    cells, count = labyrinth.structure.cells, state_count(labyrinth)
    transitions = transition_table(labyrinth)
    distance = distances(labyrinth, transitions)
    first = initial(labyrinth)
    start = state_index(labyrinth, first)
    rewards = np.full(count, reward(labyrinth, first))
    terminal = np.zeros(count, np.bool_)
    for cell in (labyrinth.goal, *labyrinth.ice):
        rewards[cell::cells] = reward(labyrinth, State(cell))
        terminal[cell::cells] = is_terminal(labyrinth, State(cell))
    if normalised:
        rewards[labyrinth.goal :: cells] = normalised_goal_reward(labyrinth, distance[start])
    arrays = (
        np.array(transitions, np.int32),
        rewards,
        terminal,
        np.array(distance, np.int64),
        optimal_actions(labyrinth),
    )
    for array in arrays:
        array.setflags(write=False)
    return LabyrinthTables(labyrinth, start, *arrays)

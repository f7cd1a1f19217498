"""Labyrinths as arrays over their numbered states, so that a step is a look-up."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.world.batch_sampling import Structures
from labyrinth_core.world.dynamics import (
    GOAL_REWARD,
    STEP_PENALTY,
    State,
    initial,
    is_terminal,
    reward,
    state_count,
    state_index,
)
from labyrinth_core.world.labyrinth import UNREACHABLE, Labyrinth
from labyrinth_core.world.solver import optimal_actions, table_and_distances


@dataclass(frozen=True, eq=False)
class Tables:
    """All that an environment says of a labyrinth, or of several, computed once.

    Of several, each array has the labyrinths as another first axis.
    """

    initial: int
    """Number of the state an episode begins in."""
    transitions: NDArray[np.int32]
    """Number of the state that each action leads to, shape (states, 4)."""
    rewards: NDArray[np.float64]
    """Reward of a step that leads to the state, shape (states,)."""
    terminal: NDArray[np.bool_]
    """Whether the episode ends in the state, shape (states,)."""
    distances: NDArray[np.int64]
    """Least moves to the goal, -1 where no route leads there, shape (states,)."""
    optimal_actions: NDArray[np.bool_]
    """Which actions begin a shortest route, shape (states, 4)."""


def tabulate(labyrinth: Labyrinth, *, normalised: bool = False) -> Tables:
    """Return the tables of a labyrinth; arrays are read-only.

    Args:
        labyrinth: The labyrinth to tabulate.
        normalised: Whether the goal pays so much that an optimal episode returns exactly 1.
    """
    cells, count = labyrinth.structure.cells, state_count(labyrinth)
    transitions, distance = table_and_distances(labyrinth)
    first = initial(labyrinth)
    start = state_index(labyrinth, first)
    rewards = np.full(count, reward(labyrinth, first))
    terminal = np.zeros(count, np.bool_)
    for cell in (labyrinth.goal, *labyrinth.ice):
        rewards[cell::cells] = reward(labyrinth, State(cell))
        terminal[cell::cells] = is_terminal(labyrinth, State(cell))
    if normalised:
        rewards[labyrinth.goal :: cells] += (distance[start] - 1) * STEP_PENALTY / cells
    arrays = (
        np.array(transitions, np.int32),
        rewards,
        terminal,
        np.array(distance, np.int64),
        optimal_actions(labyrinth),
    )
    for array in arrays:
        array.setflags(write=False)
    return Tables(start, *arrays)


def tabulate_many(
    structures: Structures, start: int, goal: int, *, normalised: bool = False
) -> Tables:
    """Return the tables of labyrinths without tiles, in which a state is a cell.

    Args:
        structures: Their structures, which are connected.
        start: Cell of the start of each.
        goal: Cell of the goal of each.
        normalised: As for `tabulate`.
    """
    count, cells = structures.up.shape
    transitions = structures.moves()
    onward = transitions + (cells * np.arange(count))[:, None, None]
    distances = distances_from(onward.reshape(-1, 4), goal + cells * np.arange(count))
    after = distances[onward]
    distances = distances.reshape(count, cells)
    rewards = np.full((count, cells), -STEP_PENALTY / cells)
    rewards[:, goal] = GOAL_REWARD
    if normalised:
        rewards[:, goal] += (distances[:, start] - 1) * STEP_PENALTY / cells
    terminal = np.zeros((count, cells), np.bool_)
    terminal[:, goal] = True
    optimal = after == distances[:, :, None] - 1
    return Tables(start, transitions, rewards, terminal, distances, optimal)


def distances_from(
    onward: NDArray[np.int64],
    origins: NDArray[np.int64],
    blocked: NDArray[np.int64] | None = None,
) -> NDArray[np.int64]:
    """Return the least number of moves between each cell and an origin, breadth first, shape (N,).

    Args:
        onward: The cells that the four actions lead to from each cell, shape (N, 4).
        origins: Some cells, one to a labyrinth.
        blocked: Cells that no way leads through.
    """
    moves, distances = 0, np.full(len(onward), UNREACHABLE)
    claims = np.empty(len(onward), np.int64)
    border = origins
    blocked = claims[:0] if blocked is None else blocked
    distances[blocked] = 0
    while len(border):
        distances[border] = moves
        moves += 1
        beside = onward[border].ravel()
        beside = beside[distances[beside] == UNREACHABLE]
        # A cell beside two of the border goes on once: in the place that claimed it last.
        places = np.arange(len(beside))
        claims[beside] = places
        border = beside[claims[beside] == places]
    distances[blocked] = UNREACHABLE
    return distances

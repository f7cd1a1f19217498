"""The tables of labyrinths by the thousand, worked out together in numpy."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.world.batch_sampling import Structures
from labyrinth_core.world.dynamics import GOAL_REWARD, STEP_PENALTY
from labyrinth_core.world.labyrinth import UNREACHABLE


@dataclass(frozen=True, eq=False)
class BatchTables:
    """`state_tables.LabyrinthTables` of n labyrinths without tiles, of one start and one goal.

    A state is a cell.
    """

    structures: Structures
    start: int
    goal: int
    transitions: NDArray[np.int32]
    """The state that each action leads to, shape (n, states, 4)."""
    rewards: NDArray[np.float64]
    """What a step that leads to the state pays, shape (n, states)."""
    terminal: NDArray[np.bool_]
    """Whether the episode ends in the state, shape (n, states)."""
    distances: NDArray[np.int64]
    """Least moves to the goal, shape (n, states)."""
    optimal_actions: NDArray[np.bool_]
    """Which actions begin a shortest route, shape (n, states, 4)."""

    def shortest_routes(self) -> NDArray[np.int8]:
        """Return the actions of a shortest route in each, shape (n, moves of the longest).

        Of several actions that begin one it takes the first. After the goal come -1.
        """
        moves = self.distances[:, self.start]
        labyrinths, state = np.arange(len(moves)), np.full(len(moves), self.start)
        first = self.optimal_actions.argmax(axis=2).astype(np.int8)
        routes: NDArray[np.int8] = np.empty((len(moves), moves.max(initial=0)), np.int8)
        for actions in routes.T:
            actions[:] = first[labyrinths, state]
            state = self.transitions[labyrinths, state, actions]
        routes[np.arange(routes.shape[1]) >= moves[:, None]] = -1
        return routes


def tabulate_many(
    structures: Structures, start: int, goal: int, *, normalised: bool = False
) -> BatchTables:
    """Return the tables of connected structures with a start and a goal.

    Args:
        structures: What to tabulate.
        start: Cell of the start of each.
        goal: Cell of the goal of each.
        normalised: Whether the goal pays so much that an optimal episode returns exactly 1.
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
    return BatchTables(structures, start, goal, transitions, rewards, terminal, distances, optimal)


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

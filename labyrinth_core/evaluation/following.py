"""How the episodes of a policy go, by look-ups in `LabyrinthArrays`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.evaluation.labyrinth_arrays import LabyrinthArrays
from labyrinth_core.world.dynamics import GOAL_REWARD, ICE_REWARD, STEP_PENALTY

if TYPE_CHECKING:
    from labyrinth_core.evaluation.policy import Policy

OUTCOMES = {
    "solved": "the goal is reached",
    "loop": "the agent goes round between cells until it is cut",
    "wall": "the agent walks into a wall or a locked door until it is cut",
    "ice": "the agent steps on ice",
    "cut": "a fixed path ends elsewhere than on the goal",
}
"""How an episode may end."""

SEEN_TOGETHER = 1024
"""States that a policy is shown at once, at most."""


@dataclass(frozen=True, eq=False)
class Episodes:
    """One episode in each of L labyrinths."""

    outcomes: NDArray[np.str_]
    """Keys of `OUTCOMES`, shape (L,)."""
    moves: NDArray[np.int64]
    """Steps taken, into walls too, shape (L,)."""
    cells: int
    """Of each labyrinth."""

    @property
    def solved(self) -> NDArray[np.bool_]:
        """Whether the goal was reached, shape (L,)."""
        solved: NDArray[np.bool_] = self.outcomes == "solved"
        return solved

    @property
    def returns(self) -> NDArray[np.float64]:
        """Sum of the rewards, shape (L,); exactly -4 for an episode that is cut.

        Added up at once, since a thousand small numbers one after the other leave a rest.
        """
        ends = np.select([self.solved, self.outcomes == "ice"], [GOAL_REWARD, ICE_REWARD])
        returns: NDArray[np.float64] = ends - STEP_PENALTY * (self.moves - (ends != 0)) / self.cells
        return returns


def greedy_actions(policy: Policy, arrays: LabyrinthArrays) -> NDArray[np.int64]:
    """Return what a policy does in each state, shape (S,); 0 where nothing can be done any more.

    Of actions with the same score it is the first.
    """
    actions = np.zeros(len(arrays.terminal), np.int64)
    acting = np.flatnonzero(~arrays.terminal)
    for begin in range(0, len(acting), SEEN_TOGETHER):
        states = acting[begin : begin + SEEN_TOGETHER]
        actions[states] = policy.logits(arrays.observations[states]).argmax(axis=1)
    return actions


def follow(arrays: LabyrinthArrays, actions: NDArray[np.int64]) -> Episodes:
    """Return how the episodes go in which each state has its action.

    Args:
        arrays: The labyrinths.
        actions: Of each state, shape (S,).
    """
    after = np.take_along_axis(arrays.next_state, actions[:, None], axis=1)[:, 0]
    state = arrays.initial
    moves = np.zeros(len(state), np.int64)
    # Whoever is under way for longer than a labyrinth has states was somewhere twice, and so
    # does the same over and over until the episode is cut.
    for _ in range(np.bincount(arrays.labyrinth).max()):
        moves += ~arrays.terminal[state]
        state = after[state]
    ended = arrays.terminal[state]
    outcomes = np.select(
        [arrays.goal[state], ended, after[state] == state], ["solved", "ice", "wall"], "loop"
    )
    return Episodes(outcomes, np.where(ended, moves, arrays.step_limit), arrays.cells)


def success_rate(policy: Policy, arrays: LabyrinthArrays) -> float:
    """Return the share of labyrinths that a greedy episode of a policy solves."""
    return float(follow(arrays, greedy_actions(policy, arrays)).solved.mean())

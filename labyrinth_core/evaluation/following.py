"""Greedy episodes of a policy: by look-ups in `LabyrinthArrays`, or state by state.

The look-ups need all states of a labyrinth; large labyrinths are seen only where they are visited.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.data.observations import ObservationSpec
from labyrinth_core.evaluation.answers import Policy, decide
from labyrinth_core.evaluation.labyrinth_arrays import LabyrinthArrays
from labyrinth_core.world.dynamics import (
    GOAL_REWARD,
    ICE_REWARD,
    STEP_LIMIT,
    STEP_PENALTY,
    State,
    initial,
    is_terminal,
    transition,
)
from labyrinth_core.world.labyrinth import Labyrinth

OUTCOMES = {
    "solved": "the goal is reached",
    "loop": "the agent goes round between cells until the episode is cut",
    "wall": "the agent walks into a wall or a locked door until the episode is cut",
    "ice": "the agent steps on ice",
    "cut": "a fixed route ends elsewhere than on the goal",
}
"""Outcome of an episode -> what happens."""

SEEN_TOGETHER = 256
"""The largest number of states that a policy sees at once; a ResNet-18 takes a megabyte each."""

UNKNOWN = -1
"""Stands for the action in a state in which the policy has not been asked."""

DRAWN_TOGETHER = 64
"""The largest number of pictures that are drawn at once."""


@dataclass(frozen=True, eq=False)
class Episodes:
    """The results of one episode in each of L labyrinths, or of E; then shapes are (E, L)."""

    outcomes: NDArray[np.str_]
    """Keys of `OUTCOMES`, shape (L,)."""
    moves: NDArray[np.int64]
    """Numbers of steps, those into walls included, shape (L,)."""
    cells: int
    """The number of cells of a labyrinth."""

    @property
    def step_limit(self) -> int:
        """The number of steps after which an episode is cut."""
        return STEP_LIMIT * self.cells

    @property
    def solved(self) -> NDArray[np.bool_]:
        """Whether the goal was reached, shape (L,)."""
        solved: NDArray[np.bool_] = self.outcomes == "solved"
        return solved

    @property
    def returns(self) -> NDArray[np.float64]:
        """Sums of the rewards, shape (L,); exactly -4 for an episode that is cut.

        Computed as a product, since a sum of many small penalties gathers rounding errors.
        """
        ends = np.select([self.solved, self.outcomes == "ice"], [GOAL_REWARD, ICE_REWARD])
        returns: NDArray[np.float64] = ends - STEP_PENALTY * (self.moves - (ends != 0)) / self.cells
        return returns


def greedy_actions(policy: Policy, arrays: LabyrinthArrays) -> NDArray[np.int64]:
    """Return the action of a policy in each state, shape (S,); 0 in terminal states.

    Raises:
        PolicyError: It raises an error, or answers with anything but actions.
    """
    actions = np.zeros(len(arrays.terminal), np.int64)
    acting = np.flatnonzero(~arrays.terminal)
    actions[acting] = _decisions(policy, arrays, acting)
    return actions


def _decisions(
    policy: Policy, arrays: LabyrinthArrays, states: NDArray[np.int64]
) -> NDArray[np.int64]:
    """Return the action of a policy in each of some states, at least one."""
    parts = [states[begin:][:SEEN_TOGETHER] for begin in range(0, len(states), SEEN_TOGETHER)]
    return np.concatenate([decide(policy, arrays.observations[part]) for part in parts])


def follow(arrays: LabyrinthArrays, actions: NDArray[np.int64]) -> Episodes:
    """Return the results of the episodes of a policy with one action a state, shape (S,)."""
    after = np.take_along_axis(arrays.next_state, actions[:, None], axis=1)[:, 0]
    state = arrays.initial
    moves = np.zeros(len(state), np.int64)
    # An episode with more steps than states has been in one state twice, and so repeats itself
    # until it is cut.
    for _ in range(np.bincount(arrays.labyrinth).max()):
        moves += ~arrays.terminal[state]
        state = after[state]
    ended = arrays.terminal[state]
    outcomes = np.select(
        [arrays.goal[state], ended, after[state] == state], ["solved", "ice", "wall"], "loop"
    )
    return Episodes(outcomes, np.where(ended, moves, arrays.step_limit), arrays.cells)


def success_rate(policy: Policy, arrays: LabyrinthArrays) -> float:
    """Return the share of labyrinths that a policy, acting greedily, solves; see `solved_by`."""
    return float(solved_by(policy, arrays).mean())


def solved_by(policy: Policy, arrays: LabyrinthArrays) -> NDArray[np.bool_]:
    """Return which labyrinths a policy, acting greedily, solves, shape (L,).

    The policy is asked only in the states that it visits, at 5x5 about a third of all.
    """
    actions = np.full(len(arrays.terminal), UNKNOWN)
    state = arrays.initial
    # Where an action is known, the agent has been before: it goes round in a loop.
    while len(state := state[~arrays.terminal[state] & (actions[state] == UNKNOWN)]):
        actions[state] = _decisions(policy, arrays, state)
        state = arrays.next_state[state, actions[state]]
    return follow(arrays, actions).solved


@dataclass(frozen=True)
class GreedyEpisode:
    """A greedy episode, up to the goal, to ice, or to a state that was visited before."""

    labyrinth: Labyrinth
    states: list[State]

    @property
    def solved(self) -> bool:
        """Whether the episode ends on the goal."""
        return self.states[-1].agent == self.labyrinth.goal


def greedy_episodes(
    policy: Policy, labyrinths: Sequence[Labyrinth], image_size: int
) -> list[GreedyEpisode]:
    """Return one greedy episode in each labyrinth, of which only the visited states are drawn.

    The labyrinths have one size, and the policy is shown pictures of `image_size` pixels each way.
    A policy without memory that comes back to a state never reaches the goal.
    """
    spec = ObservationSpec("image", image_size, draw=True)
    episodes = [GreedyEpisode(each, [initial(each)]) for each in labyrinths]
    running = episodes
    while running:
        for begin in range(0, len(running), DRAWN_TOGETHER):
            some = running[begin : begin + DRAWN_TOGETHER]
            pictures = spec.look([(each.labyrinth, each.states[-1]) for each in some])
            actions = decide(policy, pictures)
            for each, action in zip(some, actions.tolist(), strict=True):
                each.states.append(transition(each.labyrinth, each.states[-1], action))
        running = [
            each
            for each in running
            if each.states[-1] not in each.states[:-1]
            and not is_terminal(each.labyrinth, each.states[-1])
        ]
    return episodes

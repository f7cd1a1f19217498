"""What a step does: the one truth shared by solver, roll-out, environment and validation.

A wall leaves the agent where it is and costs a step like any other, whatever lies behind it.
"""

from __future__ import annotations

from typing import NamedTuple

from labyrinth_core.world.labyrinth import Labyrinth, Moves

GOAL_REWARD = 1.0
ICE_REWARD = -100.0
STEP_PENALTY = 0.1
"""Divided by the number of cells, what a step costs that does not end on the goal."""
STEP_LIMIT = 40
"""Times the number of cells, after how many steps an episode is cut: it then returns -4."""


class State(NamedTuple):
    """What changes during an episode."""

    agent: int
    """The agent's cell."""
    has_key: bool = False
    door_open: bool = False


def initial(labyrinth: Labyrinth) -> State:
    """Return the state an episode begins in."""
    return State(labyrinth.start)


def transition(labyrinth: Labyrinth, state: State, action: int) -> State:
    """Return the state after `action`; a wall or a locked door leaves the agent in place."""
    agent, has_key, door_open = state
    target = labyrinth.structure.moves[agent][action]
    if target == labyrinth.door and not door_open:
        if not has_key:
            return state
        door_open = True
    return State(target, has_key or target == labyrinth.key, door_open)


def is_terminal(labyrinth: Labyrinth, state: State) -> bool:
    """Return whether the episode ends in `state`: on the goal, or on ice."""
    return state.agent == labyrinth.goal or state.agent in labyrinth.ice


def reward(labyrinth: Labyrinth, state: State) -> float:
    """Return what the step that led to `state` pays."""
    if state.agent == labyrinth.goal:
        return GOAL_REWARD
    if state.agent in labyrinth.ice:
        return ICE_REWARD
    return -STEP_PENALTY / labyrinth.structure.cells


def normalised_goal_reward(labyrinth: Labyrinth, optimal_moves: int) -> float:
    """Return what the goal pays so that an optimal episode returns exactly 1."""
    return GOAL_REWARD + (optimal_moves - 1) * STEP_PENALTY / labyrinth.structure.cells


def step_limit(labyrinth: Labyrinth) -> int:
    """Return after how many steps an episode is truncated."""
    return STEP_LIMIT * labyrinth.structure.cells


def state_count(labyrinth: Labyrinth) -> int:
    """Return how many states there are: a cell, times three with a door (locked, key, open)."""
    return labyrinth.structure.cells * (1 if labyrinth.door is None else 3)


def state_index(labyrinth: Labyrinth, state: State) -> int:
    """Return the number of a state: its cell, plus the number of cells for key and for door."""
    return state.agent + labyrinth.structure.cells * (state.has_key + state.door_open)


def state_at(labyrinth: Labyrinth, index: int) -> State:
    """Return the state with a number; the inverse of `state_index`."""
    phase, agent = divmod(index, labyrinth.structure.cells)
    return State(agent, phase >= 1, phase == 2)


def transition_table(labyrinth: Labyrinth) -> list[Moves]:
    """Return the numbers of the states that the four actions lead to from each state.

    Rows of states that the agent cannot be in mean nothing: on the door before it opened, on
    the key without having it.
    """
    if labyrinth.door is None:
        return labyrinth.structure.moves
    table = []
    for index in range(state_count(labyrinth)):
        state = state_at(labyrinth, index)
        up, right, down, left = (
            state_index(labyrinth, transition(labyrinth, state, action)) for action in range(4)
        )
        table.append((up, right, down, left))
    return table

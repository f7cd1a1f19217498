"""The dynamics, shared by solver, rollout, environment and validation.

A move into a wall leaves the agent where it is and costs a step, whatever lies behind the wall.
"""

from __future__ import annotations

from labyrinth_core.world.labyrinth import Labyrinth, Moves
from labyrinth_core.world.labyrinth import State as State

GOAL_REWARD = 1.0
ICE_REWARD = -100.0
STEP_PENALTY = 0.1
"""The cost of a step that does not end on the goal, times the number of cells."""
STEP_LIMIT = 40
"""The number of steps for each cell after which an episode is cut; its return is then -4."""


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
    """Return the reward of the step that led to `state`."""
    if state.agent == labyrinth.goal:
        return GOAL_REWARD
    if state.agent in labyrinth.ice:
        return ICE_REWARD
    return -STEP_PENALTY / labyrinth.structure.cells


def step_limit(labyrinth: Labyrinth) -> int:
    """Return the number of steps after which an episode is truncated."""
    return STEP_LIMIT * labyrinth.structure.cells


def state_count(labyrinth: Labyrinth) -> int:
    """Return the number of states: the cells, times three with a door (locked, key held, open)."""
    return labyrinth.structure.cells * (1 if labyrinth.door is None else 3)


def state_index(labyrinth: Labyrinth, state: State) -> int:
    """Return the index of a state: its cell, plus the number of cells for the key and the door."""
    return state.agent + labyrinth.structure.cells * (state.has_key + state.door_open)


def state_at(labyrinth: Labyrinth, index: int) -> State:
    """Return the state with an index; the inverse of `state_index`."""
    phase, agent = divmod(index, labyrinth.structure.cells)
    return State(agent, phase >= 1, phase == 2)


def transition_table(labyrinth: Labyrinth) -> list[Moves]:
    """Return the indices of the states that the four actions lead to from each state.

    Rows of impossible states have no meaning: on the closed door, or on the key without it.
    """
    moves, cells = labyrinth.structure.moves, labyrinth.structure.cells
    if labyrinth.door is None:
        return moves
    table = []
    for index in range(state_count(labyrinth)):
        after = moves[index % cells]
        if labyrinth.door in after or labyrinth.key in after:
            state = state_at(labyrinth, index)
            up, right, down, left = (
                state_index(labyrinth, transition(labyrinth, state, action)) for action in range(4)
            )
        else:  # Nothing but the cell changes.
            up, right, down, left = (cell + index - index % cells for cell in after)
        table.append((up, right, down, left))
    return table

"""The dynamics, visibility, and episodes; shared by solver, environment and validation.

A move into a wall leaves the agent where it is and costs a step, whatever lies behind the wall.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import IntEnum
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.world.labyrinth import Labyrinth, Moves, Structure, whole

GOAL_REWARD = 1.0
ICE_REWARD = -100.0
STEP_PENALTY = 0.1
"""The cost of a step that does not end on the goal, before division by the number of cells."""
STEP_LIMIT = 40
"""The number of steps per cell after which an episode is truncated; its return is then -4."""


class Action(IntEnum):
    """The four moves of an agent; `UP` increases the row, and points up in images."""

    UP = 0
    RIGHT = 1
    DOWN = 2
    LEFT = 3


class State(NamedTuple):
    """The part of the world that changes during an episode."""

    agent: int
    """The agent's cell."""
    has_key: bool = False
    door_open: bool = False


def neighbours(cell: int, height: int, width: int) -> dict[Action, int]:
    """Return the neighbours of `cell` in the grid by action, regardless of walls."""
    row, column = divmod(cell, width)
    beside = {}
    if row + 1 < height:
        beside[Action.UP] = cell + width
    if column + 1 < width:
        beside[Action.RIGHT] = cell + 1
    if row > 0:
        beside[Action.DOWN] = cell - width
    if column > 0:
        beside[Action.LEFT] = cell - 1
    return beside


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
    return labyrinth.structure.cells * labyrinth.task.rules.phases


def state_index(labyrinth: Labyrinth, state: State) -> int:
    """Return a state's index: its cell, plus the cell count once for the key, once for the door."""
    return state.agent + labyrinth.structure.cells * (state.has_key + state.door_open)


def state_at(labyrinth: Labyrinth, index: int) -> State:
    """Return the state with the given index; the inverse of `state_index`."""
    phase, agent = divmod(index, labyrinth.structure.cells)
    return State(agent, phase >= 1, phase == 2)


def transition_table(labyrinth: Labyrinth) -> list[Moves]:
    """Return, for each state, the indices of the states that the four actions lead to.

    Rows of impossible states are meaningless: on a closed door, or on the key without holding it.
    """
    moves, cells = labyrinth.structure.moves, labyrinth.structure.cells
    key, door = labyrinth.key, labyrinth.door
    if key is None or door is None:
        return moves
    # Where the agent steps neither on the key nor through the door, only its cell changes.
    table = [
        (up + others, right + others, down + others, left + others)
        for others in range(0, state_count(labyrinth), cells)
        for up, right, down, left in moves
    ]
    beside = {key, door, *moves[key], *moves[door]}
    for index in [*beside, *(cell + cells for cell in beside)]:
        state = state_at(labyrinth, index)
        up, right, down, left = (
            state_index(labyrinth, transition(labyrinth, state, action)) for action in range(4)
        )
        table[index] = up, right, down, left
    return table


@dataclass(frozen=True, eq=False)
class Episode:
    """The states, actions and rewards of one episode, from the initial state of a labyrinth."""

    labyrinth: Labyrinth
    states: tuple[State, ...]
    """The T + 1 states visited."""
    actions: NDArray[np.int8]
    """The action taken in each state but the last, shape (T,)."""
    rewards: NDArray[np.float32]
    """The reward received for each action, shape (T,)."""

    def __post_init__(self) -> None:
        steps = len(self.states) - 1
        if not len(self.actions) == len(self.rewards) == steps:
            raise ValueError(
                f"an episode of {steps + 1} states has {steps} actions and rewards, "
                f"not {len(self.actions)} and {len(self.rewards)}"
            )
        self.actions.setflags(write=False)
        self.rewards.setflags(write=False)

    def __len__(self) -> int:
        """Return the number of moves."""
        return len(self.actions)

    @property
    def terminated(self) -> bool:
        """Whether the episode ends on the goal or on ice, as opposed to being truncated."""
        return is_terminal(self.labyrinth, self.states[-1])


def replay(labyrinth: Labyrinth, actions: Iterable[int]) -> Episode:
    """Return the episode in which the agent takes `actions` from the initial state.

    Raises:
        ValueError: An action is not one of the four, or comes after the end of the episode.
    """
    states = [initial(labyrinth)]
    taken: list[int] = []
    for action in actions:
        if not 0 <= action < 4:
            raise ValueError(f"action {action}: the actions are 0, 1, 2 and 3")
        if is_terminal(labyrinth, states[-1]):
            raise ValueError(f"the episode ends after {len(taken)} steps, but an action follows")
        states.append(transition(labyrinth, states[-1], action))
        taken.append(action)
    return _episode(labyrinth, states, taken)


def random_episode(labyrinth: Labyrinth, rng: np.random.Generator, max_steps: int) -> Episode:
    """Return an episode of uniformly random actions, truncated after `max_steps`.

    Raises:
        ValueError: `max_steps` is not a non-negative integer.
    """
    actions = rng.integers(4, size=whole("max_steps", max_steps, 0)).tolist()
    states = [initial(labyrinth)]
    for action in actions:
        states.append(transition(labyrinth, states[-1], action))
        if is_terminal(labyrinth, states[-1]):
            break
    return _episode(labyrinth, states, actions[: len(states) - 1])


def _episode(labyrinth: Labyrinth, states: list[State], actions: list[int]) -> Episode:
    rewards = [reward(labyrinth, state) for state in states[1:]]
    return Episode(
        labyrinth, tuple(states), np.array(actions, np.int8), np.array(rewards, np.float32)
    )


DIAGONALS = tuple(product((Action.RIGHT, Action.LEFT), (Action.UP, Action.DOWN)))
"""The four diagonals, each as a step sideways, then a step up or down."""


def visible_from(structure: Structure, cell: int) -> frozenset[int]:
    """Return the cells visible from `cell`: itself, and unobstructed straight lines and diagonals.

    A diagonal step is unobstructed if the passage sideways, and from there the passage up or down,
    are both open; sideways comes first, as in the authors' code.
    """
    moves = structure.moves
    seen = {cell}
    for action in Action:
        at = cell
        while (after := moves[at][action]) != at:
            at = after
            seen.add(at)
    for side, updown in DIAGONALS:
        at = cell
        while (beside := moves[at][side]) != at and (after := moves[beside][updown]) != beside:
            at = after
            seen.add(at)
    return frozenset(seen)


def seen_together(
    moves: NDArray[np.int64], agents: NDArray[np.int64], side: int
) -> NDArray[np.bool_]:
    """Return which of the N cells of many structures are visible, by the rule of `visible_from`.

    Args:
        moves: The cells that the four actions lead to from each cell, shape (N, 4).
        agents: The cell of the agent in each structure.
        side: The larger of the structures' height and width.

    Returns:
        Whether an agent sees the cell, shape (N,).
    """
    flat = moves.ravel()
    seen = np.zeros(len(moves), np.bool_)
    seen[agents] = True
    for action in Action:
        at = agents
        for _ in range(side - 1):
            at = flat.take(4 * at + action)  # A wall leads back to a cell already seen.
            seen[at] = True
    for across, updown in DIAGONALS:
        at = agents
        for _ in range(side - 1):
            beside = flat.take(4 * at + across)
            onward = flat.take(4 * beside + updown)
            at = np.where((beside != at) & (onward != beside), onward, at)
            seen[at] = True
    return seen

"""The state of the world, the actions that change it, and the rewards.

A move into a wall leaves the agent where it is and costs a step, whatever lies behind the wall.
"""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple

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

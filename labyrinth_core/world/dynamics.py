"""Episodes: given actions or random ones, from the initial state of a labyrinth."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.checks import whole
from labyrinth_core.world.labyrinth import Labyrinth
from labyrinth_core.world.rules import State


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

    @classmethod
    def random(cls, labyrinth: Labyrinth, rng: np.random.Generator, max_steps: int) -> Episode:
        """Return an episode of uniformly random actions, truncated after `max_steps`.

        Raises:
            ValueError: `max_steps` is not a non-negative integer.
        """
        actions = rng.integers(4, size=whole("max_steps", max_steps, 0)).tolist()
        states = [labyrinth.initial]
        for action in actions:
            states.append(labyrinth.transition(states[-1], action))
            if labyrinth.is_terminal(states[-1]):
                break
        return _episode(labyrinth, states, actions[: len(states) - 1])

    def __len__(self) -> int:
        """Return the number of moves."""
        return len(self.actions)

    @property
    def terminated(self) -> bool:
        """Whether the episode ends on the goal or on ice, as opposed to being truncated."""
        return self.labyrinth.is_terminal(self.states[-1])


def replay(labyrinth: Labyrinth, actions: Iterable[int]) -> Episode:
    """Return the episode in which the agent takes `actions` from the initial state.

    Raises:
        ValueError: An action is not one of the four, or comes after the end of the episode.
    """
    states = [labyrinth.initial]
    taken: list[int] = []
    for action in actions:
        if not 0 <= action < 4:
            raise ValueError(f"action {action}: the actions are 0, 1, 2 and 3")
        if labyrinth.is_terminal(states[-1]):
            raise ValueError(f"the episode ends after {len(taken)} steps, but an action follows")
        states.append(labyrinth.transition(states[-1], action))
        taken.append(action)
    return _episode(labyrinth, states, taken)


def _episode(labyrinth: Labyrinth, states: list[State], actions: list[int]) -> Episode:
    rewards = [labyrinth.reward(state) for state in states[1:]]
    return Episode(
        labyrinth, tuple(states), np.array(actions, np.int8), np.array(rewards, np.float32)
    )

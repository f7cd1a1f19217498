"""Episodes: a route replayed through the dynamics."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.world.dynamics import State, initial, is_terminal, reward, transition
from labyrinth_core.world.labyrinth import Labyrinth


@dataclass(frozen=True, eq=False)
class Episode:
    """One way through a labyrinth, from its initial state to where the episode ends."""

    labyrinth: Labyrinth
    states: tuple[State, ...]
    """The T + 1 states visited."""
    actions: NDArray[np.int8]
    """Action taken in each state but the last, shape (T,)."""
    rewards: NDArray[np.float32]
    """Reward received for each action, shape (T,)."""

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
        """Whether it ends on the goal or on ice, instead of being cut."""
        return is_terminal(self.labyrinth, self.states[-1])


def replay(labyrinth: Labyrinth, actions: Iterable[int]) -> Episode:
    """Return the episode in which the agent takes `actions`, from the initial state on.

    Raises:
        ValueError: An action is none of the four, or comes after the end of the episode.
    """
    state = initial(labyrinth)
    states = [state]
    taken: list[int] = []
    rewards: list[float] = []
    for action in actions:
        if not 0 <= action < 4:
            raise ValueError(f"action {action}: the actions are 0, 1, 2 and 3")
        if is_terminal(labyrinth, state):
            raise ValueError(f"{len(taken)} steps end the episode, but another action follows")
        state = transition(labyrinth, state, action)
        states.append(state)
        taken.append(action)
        rewards.append(reward(labyrinth, state))
    return Episode(
        labyrinth, tuple(states), np.array(taken, np.int8), np.array(rewards, np.float32)
    )


def random_episode(labyrinth: Labyrinth, rng: np.random.Generator, max_steps: int) -> Episode:
    """Return an episode of uniformly random actions, cut after `max_steps`."""
    actions = rng.integers(4, size=max_steps).tolist()
    state = initial(labyrinth)
    for step, action in enumerate(actions, start=1):
        state = transition(labyrinth, state, action)
        if is_terminal(labyrinth, state):
            return replay(labyrinth, actions[:step])
    return replay(labyrinth, actions)

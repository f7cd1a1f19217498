"""Policies that may remember or draw at random: their episodes, stepped in lock-step."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.evaluation.answers import Policy, PolicyError, as_function, asked, decide
from labyrinth_core.evaluation.following import Episodes
from labyrinth_core.evaluation.labyrinth_arrays import LabyrinthArrays

TOGETHER = 1024
"""The largest number of episodes that are stepped at once."""


Situation = tuple[int, int, bytes]
"""An episode, the state that it is in, and what the policy remembers."""


@dataclass(frozen=True)
class Player:
    """A policy, as it is asked."""

    act: Policy
    reset: Callable[[int], object] | None
    """Begins so many episodes at once; None for a policy that remembers nothing."""
    draws: bool
    """Whether it takes a generator of random numbers."""
    remembered: Callable[[], NDArray[Any]] | None = None
    """Returns all that it remembers, a row for each episode; None for one that does not say it."""

    @property
    def forgets(self) -> bool:
        """Whether its action follows from the observation, so that look-ups do for it."""
        return self.reset is None and not self.draws

    @classmethod
    def of(cls, policy: Any, seed: int) -> Player:
        """Return a policy as it is asked: a function, a module, or an object with reset and act.

        One that takes an argument `rng` gets a generator that the seed settles.

        Raises:
            PolicyError: It is none of these.
        """
        remembers = hasattr(policy, "reset") and hasattr(policy, "act")
        if isinstance(policy, type) or not (remembers or callable(policy)):
            name = policy.__name__ if isinstance(policy, type) else type(policy).__name__
            what = "the class" if isinstance(policy, type) else "an object of"
            raise PolicyError(
                f"policy: give a function from observations to actions, or an object with "
                f"reset(count) and act(observations), not {what} {name}"
            )
        begin = policy.reset if remembers else policy
        draws = _takes_rng(begin)
        if draws:
            begin = partial(begin, rng=np.random.default_rng(seed))
        if remembers:
            remembered = None if draws else getattr(policy, "remembered", None)
            return cls(policy.act, begin, draws, remembered)
        return cls(begin if draws else as_function(policy), None, draws)


def _takes_rng(function: Callable[..., Any]) -> bool:
    try:
        return "rng" in inspect.signature(function).parameters
    except (TypeError, ValueError):  # Of a function that is not written in Python.
        return False


def step_through(player: Player, arrays: LabyrinthArrays, episodes: int) -> Episodes:
    """Return the results of some episodes in each of L labyrinths, shape (episodes, L).

    In each step all episodes are acted in at once. Those that are over are still shown, as they
    ended, to a policy that remembers, and what it answers there is not looked at. An episode in
    which state and memory, as far as a policy says it, are as they were before goes round.

    Raises:
        PolicyError: The policy raises an error, or answers with anything but actions.
    """
    places = range(0, len(arrays.initial), TOGETHER)
    blocks = [
        [_play(player, arrays, arrays.initial[place : place + TOGETHER]) for place in places]
        for _ in range(episodes)
    ]
    outcomes, moves = (
        np.stack([np.concatenate([each[part] for each in row]) for row in blocks])
        for part in (0, 1)
    )
    return Episodes(outcomes, moves, arrays.cells)


def _play(
    player: Player, arrays: LabyrinthArrays, initial: NDArray[np.int64]
) -> tuple[NDArray[Any], NDArray[np.int64]]:
    """Return the outcome and the moves of an episode in each of some labyrinths."""
    state, limit = initial.copy(), arrays.step_limit
    moves = np.full(len(state), limit)
    changed = np.zeros(len(state), np.int64)
    running = np.arange(len(state))
    if player.reset is not None:
        asked(player.reset, len(state))
    first: dict[Situation, int] = {}
    for step in range(1, limit + 1):
        here = state[running]
        if player.reset is None:
            actions = decide(player.act, arrays.observations[here])
        else:
            actions = decide(player.act, arrays.observations[state], running)
        after = arrays.next_state[here, actions]
        state[running] = after
        changed[running[after != here]] = step
        over = arrays.terminal[after]
        moves[running[over]] = step
        running = running[~over]
        if player.remembered is not None:
            held = asked(player.remembered)
            situations = [(each, state[each], held[each].tobytes()) for each in running.tolist()]
            begun = np.array([first.setdefault(each, step) for each in situations], np.int64)
            # What has happened since then will happen again and again, until the end.
            changed[running[(begun < step) & (changed[running] > begun)]] = limit
            running = running[begun == step]
        if not running.size:
            break
    # Without memory, an agent that stays somewhere has come there within as many steps as there
    # are states, long before half of the steps are over.
    stays = changed < limit / 2
    ends = [arrays.goal[state], arrays.terminal[state], stays]
    return np.select(ends, ["solved", "ice", "wall"], "loop"), moves

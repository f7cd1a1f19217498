"""Transitions between numbered states, from episodes and rollouts, and the states' observations."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from labyrinth_core.data import Selection
from labyrinth_core.errors import DatasetError
from labyrinth_core.evaluation import LabyrinthArrays
from labyrinth_core.learning.networks.network import MOMENTUM, double
from labyrinth_core.pictures import Looks

SETTLED_BY = 256
"""The batch size of `settle`, on which the statistics depend."""


class Observations:
    """The observations of S states on a device, whether they are held or drawn when indexed."""

    def __init__(self, observations: NDArray[Any] | Looks, device: torch.device | str) -> None:
        """Hold the observations on the device if they are an array.

        Args:
            observations: The observations of `LabyrinthArrays`.
            device: The device to compute on.
        """
        self.device = torch.device(device)
        self._seen: Tensor | Looks = (
            observations
            if isinstance(observations, Looks)
            else torch.as_tensor(observations, device=self.device)
        )

    def __len__(self) -> int:
        """Return the number of states, S."""
        return len(self._seen)

    def __getitem__(self, states: NDArray[np.int64]) -> Tensor:
        """Return the observations of B states as a new tensor, shape (B, ...)."""
        if isinstance(self._seen, Looks):
            return torch.as_tensor(self._seen[states], device=self.device)
        # Indexing a tensor by [] is ten times slower.
        return self._seen.index_select(0, torch.as_tensor(states, device=self.device))


def parts_of(count: int, size: int) -> Iterator[NDArray[np.int64]]:
    """Yield the numbers from 0 to `count` - 1 in order, `size` at a time."""
    for begin in range(0, count, size):
        yield np.arange(begin, min(begin + size, count))


class Steps(NamedTuple):
    """N transitions; states are numbered as in `LabyrinthArrays`."""

    states: NDArray[np.int64]
    """The state acted in, shape (N,)."""
    actions: NDArray[np.int64]
    """The action taken, shape (N,)."""
    next_states: NDArray[np.int64]
    """The state that the action led to, shape (N,)."""


class Rollout(NamedTuple):
    """T steps of N agents that sample their actions, each array of shape (T, N)."""

    states: NDArray[np.int64]
    actions: NDArray[np.int64]
    next_states: NDArray[np.int64]
    """The state that the action led to; after the last step of an episode, a new one begins."""
    over: NDArray[np.bool_]
    """Whether the step was the last of its episode: terminated, or truncated at the step limit."""
    done: NDArray[np.bool_]
    """Whether the step terminated the episode, on the goal or on ice."""

    @property
    def transitions(self) -> NDArray[np.int64]:
        """The steps as rows (s, a, s'), shape (T * N, 3)."""
        return np.stack([self.states, self.actions, self.next_states], axis=2).reshape(-1, 3)


def load_steps(selection: Selection, arrays: LabyrinthArrays) -> Steps:
    """Return the transitions of all episodes of a split or of a part of it, in order.

    Args:
        selection: `train`, or another split of the labyrinths in `arrays`, such as `random`.
        arrays: The labyrinths, with their states numbered.

    Raises:
        DatasetError: The split does not exist, or one of its labyrinths is not in `arrays`.
    """
    known = set(arrays.labyrinth_ids.tolist())
    beginnings, routes = [], []
    for episode in selection.iterate_episodes(observation="vector"):
        if episode.labyrinth_id not in known:
            raise DatasetError(
                f"split={selection.split}: labyrinth {episode.labyrinth_id:016x} was not trained on"
            )
        beginnings.append(episode.beginning)
        routes.append(episode.actions)
    return steps_along(arrays, arrays.numbers_of(beginnings), routes)


def steps_along(
    arrays: LabyrinthArrays, starts: NDArray[np.int64], routes: Sequence[NDArray[np.int64]]
) -> Steps:
    """Return the transitions of routes, each a start, shape (routes,), and its actions."""
    walked = list(arrays.walk(starts, routes))
    return Steps(
        np.concatenate([states[:-1] for states in walked]),
        np.concatenate(routes),
        np.concatenate([states[1:] for states in walked]),
    )


def softmax(scores: Tensor) -> NDArray[np.float64]:
    """Return the softmax of each row, shape (S, 4), in float64 so that the rows sum to 1."""
    table: NDArray[np.float64] = torch.softmax(double(scores), 1).cpu().numpy()
    return table


def settle(network: nn.Module, observations: Observations) -> None:
    """Compute batch normalisation's running statistics, and switch to evaluation mode.

    For methods that train in evaluation mode, where the statistics of a fresh network would keep
    their initial values. The observations are on the network's device.
    """
    normalising = [each for each in network.modules() if isinstance(each, nn.BatchNorm2d)]
    for layer in normalising:
        layer.reset_running_stats()
        layer.momentum = None  # The mean over all batches, weighted equally.
    network.train()
    with torch.no_grad():
        for states in parts_of(len(observations), SETTLED_BY):
            network(observations[states])
    for layer in normalising:
        layer.momentum = MOMENTUM
    network.eval()


def draw(probabilities: NDArray[np.float64], rng: np.random.Generator) -> NDArray[np.int64]:
    """Sample a class from each row of probabilities, and return them, shape (N,)."""
    below = np.cumsum(probabilities[:, :-1], axis=1) <= rng.random((len(probabilities), 1))
    drawn: NDArray[np.int64] = below.sum(axis=1)
    return drawn


def roll_out(
    arrays: LabyrinthArrays,
    probabilities: NDArray[np.float64],
    where: NDArray[np.int64],
    taken: NDArray[np.int64],
    steps: int,
    rng: np.random.Generator,
) -> Rollout:
    """Roll out a policy with one agent per labyrinth; a finished episode is followed by a new one.

    Args:
        arrays: The labyrinths.
        probabilities: The probability of each action in each state, shape (S, 4).
        where: The current state of each agent, shape (L,); changed in place.
        taken: The number of steps in each agent's current episode, shape (L,); changed in place.
        steps: The number of steps that each agent takes.
        rng: The source of the actions.
    """
    rows = []
    for _ in range(steps):
        states = where.copy()
        actions = draw(probabilities[states], rng)
        after = arrays.next_state[states, actions]
        done = arrays.done[states, actions]
        taken += 1
        over = done | (taken >= arrays.step_limit)
        where[:] = np.where(over, arrays.initial, after)
        taken[over] = 0
        rows.append(Rollout(states, actions, after, over, done))
    return Rollout(*map(np.stack, zip(*rows, strict=True)))

"""What a method learns from: the labyrinths of train, their observations, and steps in them.

States are numbered as in `LabyrinthArrays`.

With `train_labyrinths=fresh`, train has no end: each epoch draws new labyrinths and shows them
once. They are train of the same config with another seed, which follows from the seed of the run
and the number of the epoch. So they are in the bucket of train, and none of them, nor its mirror
image, is in validation or test of any dataset with these buckets. `splits.min_walls` is not
enforced.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain, islice
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from labyrinth_core.data import Dataset, DatasetConfig, Drawing, Selection
from labyrinth_core.errors import DatasetError
from labyrinth_core.evaluation import LabyrinthArrays, RunName
from labyrinth_core.learning.examples import ExampleSampler
from labyrinth_core.learning.networks.network import ACTIONS, double
from labyrinth_core.learning.spec import NetworkSpec
from labyrinth_core.pictures import Looks, ObservationSpec
from labyrinth_core.world import Labyrinth

WALK = 50
"""The number of random steps in each labyrinth that is in no dataset."""
RENEWING = 3
"""The purpose of a seed, besides those of `labyrinth_core.data.drawing`."""


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


@dataclass(frozen=True, eq=False)
class Problem:
    """Everything that a method may learn from and compute with."""

    arrays: LabyrinthArrays
    """The labyrinths of the split train only."""
    observations: Observations
    """Returns the observations of states of `arrays`, on the device."""
    demonstrations: Steps
    exploration: Callable[[], Steps]
    """Returns the steps of the random policy; raises DatasetError if the dataset has none."""
    spec: NetworkSpec
    rng: np.random.Generator
    """The source of all randomness except weights and dropout, which use torch's generator."""
    renewed: Callable[[Problem, int], Problem] | None = None
    """Returns this problem with new labyrinths, given the number of an epoch from 0 on; None if
    each epoch has the same labyrinths."""

    @property
    def device(self) -> torch.device:
        """The device to compute on."""
        return self.observations.device

    @cached_property
    def examples(self) -> ExampleSampler:
        """A sampler of pictures from the demonstrations, as they are or relabelled."""
        return ExampleSampler(self.arrays)

    @classmethod
    def of_dataset(
        cls,
        data: Dataset,
        train: LabyrinthArrays,
        spec: NetworkSpec,
        *,
        learner: str,
        train_labyrinths: int | str | None = None,
        seed: int = 0,
        device: torch.device | str = "cpu",
    ) -> Problem:
        """Return the problem that a dataset poses.

        Args:
            data: The dataset.
            train: The labyrinths of its train to learn from.
            spec: The network.
            learner: What learns, for errors, such as `method=bco`.
            train_labyrinths: The number of these labyrinths, the first ones, if they are not all;
                or `fresh`, for as many new ones in each epoch.
            seed: The seed of the run.
            device: The device to compute on.

        Raises:
            DatasetError: The splits of the dataset are of different labyrinths.
        """
        first = train_labyrinths if isinstance(train_labyrinths, int) else None

        def steps(split: str) -> Steps:
            return load_steps(data[split].filter(labyrinths=first), train)

        def exploration() -> Steps:
            try:
                return steps("random")
            except DatasetError as error:
                reason = f"{learner} learns from the split random of {data.source}"
                raise DatasetError(f"{reason}: {error}") from error

        problem = cls(
            arrays=train,
            observations=Observations(train.observations, device),
            demonstrations=steps("train"),
            exploration=exploration,
            spec=spec,
            rng=np.random.default_rng(seed),
        )
        if train_labyrinths != RunName.FRESH:
            return problem
        fresh = FreshLabyrinths(data.manifest.config, train.spec, seed)
        return fresh.renewed(replace(problem, renewed=fresh.renewed), 0)

    @classmethod
    def of_labyrinths(
        cls,
        labyrinths: Sequence[Labyrinth],
        routes: Sequence[NDArray[np.int64]],
        image_size: int,
        spec: NetworkSpec,
        seed: int = 0,
    ) -> Problem:
        """Return the problem that labyrinths without a dataset pose, on the CPU.

        Args:
            labyrinths: The labyrinths, of one size and task.
            routes: The actions of a demonstration in each.
            image_size: Pixels on each side of the pictures that are seen of the states.
            spec: The network.
            seed: The seed of the problem's randomness, and of the random policy, which takes
                `WALK` steps in each labyrinth.
        """
        seen = ObservationSpec("image", image_size, draw=True)
        arrays = LabyrinthArrays.of_labyrinths(labyrinths, seen, [[route] for route in routes])

        def exploration() -> Steps:
            uniform = np.full((len(arrays.terminal), ACTIONS), 1 / ACTIONS)
            where, taken = arrays.initial.copy(), np.zeros_like(arrays.initial)
            rollout = roll_out(arrays, uniform, where, taken, WALK, np.random.default_rng(seed))
            return Steps(*rollout.transitions.T)

        return cls(
            arrays=arrays,
            observations=Observations(arrays.observations, "cpu"),
            demonstrations=steps_along(arrays, arrays.initial, routes),
            exploration=exploration,
            spec=spec,
            rng=np.random.default_rng(seed),
        )


@dataclass(frozen=True)
class FreshLabyrinths:
    """Draws as many labyrinths for each epoch as train of a dataset has."""

    config: DatasetConfig
    """That of the dataset on whose validation and test the policy is judged."""
    spec: ObservationSpec
    """How the states are observed."""
    seed: int
    """The seed of the run."""

    def config_of(self, epoch: int) -> DatasetConfig:
        """Return the config of the dataset whose train an epoch shows."""
        key = np.random.SeedSequence(self.seed, spawn_key=(epoch, RENEWING))
        return replace(self.config, seed=int(key.generate_state(1, np.uint64)[0]))

    def labyrinths(self, epoch: int) -> Iterator[Labyrinth]:
        """Yield the labyrinths of an epoch."""
        return islice(Drawing(self.config_of(epoch)).labyrinths("train"), self.config.labyrinths)

    def renewed(self, problem: Problem, epoch: int) -> Problem:
        """Return a problem with the labyrinths of an epoch, from 0 on, and their demonstrations."""
        config, drawn = self.config_of(epoch), list(self.labyrinths(epoch))

        def routes(split: str) -> list[list[NDArray[np.int64]]]:
            """Return the actions of the episodes of each labyrinth."""
            episodes = (Drawing(config).episodes(split, labyrinth) for labyrinth in drawn)
            return [[each.actions.astype(np.int64) for each in of_one] for of_one in episodes]

        def exploration() -> Steps:
            walks = routes("random")
            starts = np.repeat(arrays.initial, [len(of_one) for of_one in walks])
            return steps_along(arrays, starts, [*chain.from_iterable(walks)])

        arrays = LabyrinthArrays.of_labyrinths(drawn, self.spec, routes("train"))
        return replace(
            problem,
            arrays=arrays,
            observations=Observations(arrays.observations, problem.device),
            demonstrations=steps_along(arrays, arrays.route_starts, arrays.routes),
            exploration=exploration,
        )


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

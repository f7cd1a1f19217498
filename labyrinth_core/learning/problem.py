"""What a method learns from: the labyrinths of train as arrays, and steps in them.

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

import numpy as np
import torch
from numpy.typing import NDArray

from labyrinth_core.data import Dataset, DatasetConfig, Drawing
from labyrinth_core.errors import DatasetError
from labyrinth_core.evaluation import LabyrinthArrays, RunName
from labyrinth_core.learning.examples import ExampleSampler
from labyrinth_core.learning.networks.network import ACTIONS
from labyrinth_core.learning.spec import NetworkSpec
from labyrinth_core.learning.steps import Observations, Steps, load_steps, roll_out, steps_along
from labyrinth_core.pictures import ObservationSpec
from labyrinth_core.world import Labyrinth

WALK = 50
"""The number of random steps in each labyrinth that is in no dataset."""
RENEWING = 3
"""The purpose of a seed, besides those of `labyrinth_core.data.drawing`."""


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

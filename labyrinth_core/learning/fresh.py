"""A training set without end: each epoch draws new labyrinths and shows them once.

The labyrinths of an epoch are train of the same config with another seed, which follows from the
seed of the run and the number of the epoch. So they are in the bucket of train, and none of them,
nor its mirror image, is in validation or test of any dataset with these buckets.
`splits.min_walls` is not enforced.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import chain, islice

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.data import DatasetConfig, Drawing
from labyrinth_core.evaluation import LabyrinthArrays
from labyrinth_core.learning.learner import Problem
from labyrinth_core.learning.observations import Observations
from labyrinth_core.learning.steps import Steps, steps_along
from labyrinth_core.pictures.observations import ObservationSpec
from labyrinth_core.world import Labyrinth

RENEWING = 3
"""The purpose of a seed, besides those of `labyrinth_core.data.drawing`."""


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
            episodes = (Drawing(config).episodes(split, each) for each in drawn)
            return [[each.actions.astype(np.int64) for each in of_one] for of_one in episodes]

        def exploration() -> Steps:
            walks = routes("random")
            starts = np.repeat(arrays.initial, [len(each) for each in walks])
            return steps_along(arrays, starts, [*chain.from_iterable(walks)])

        arrays = LabyrinthArrays.of_labyrinths(drawn, self.spec, routes("train"))
        return replace(
            problem,
            arrays=arrays,
            observations=Observations(arrays.observations, problem.device),
            demonstrations=steps_along(arrays, arrays.route_starts, arrays.routes),
            exploration=exploration,
        )

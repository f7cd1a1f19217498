"""A training set without end: each epoch draws new labyrinths and shows them once.

The labyrinths of an epoch are train of the same config with another seed, which follows from the
seed of the run and the number of the epoch. So they are in the bucket of train, and none of them,
nor its mirror image, is in validation or test of any dataset with these buckets.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import islice

import numpy as np

from labyrinth_core.data.dataset_config import DatasetConfig
from labyrinth_core.data.drawing import draw_labyrinths, solve
from labyrinth_core.data.manifest import Manifest
from labyrinth_core.data.observations import ObservationSpec
from labyrinth_core.evaluation.description import FRESH
from labyrinth_core.evaluation.labyrinth_arrays import as_arrays
from labyrinth_core.learning.learner import Problem
from labyrinth_core.learning.observations import Observations
from labyrinth_core.learning.steps import Steps, steps_along
from labyrinth_core.world.labyrinth import Labyrinth
from pipeline.config.errors import check

RENEWING = 3
"""The purpose of a seed, besides those of `labyrinth_core.data.drawing`."""


class FreshLabyrinths:
    """Draws as many labyrinths for each epoch as train of a dataset has."""

    def __init__(self, manifest: Manifest, spec: ObservationSpec, seed: int) -> None:
        """Prepare to draw.

        Args:
            manifest: That of the dataset whose validation and test the policy is judged on.
            spec: How the states are observed.
            seed: The seed of the run.

        Raises:
            ConfigError: The dataset has its splits several walls apart.
        """
        self._config, self._spec, self._seed = manifest.config, spec, seed
        self.count = sum(shard.labyrinths for shard in manifest.of("train"))
        check(
            self._config.min_walls == 1,
            f"train_labyrinths={FRESH}: labyrinths of the dataset are splits.min_walls="
            f"{self._config.min_walls} walls apart, which new ones may not be; give a dataset with "
            "splits.min_walls=1, or a number of labyrinths",
        )

    def config_of(self, epoch: int) -> DatasetConfig:
        """Return the config of the dataset whose train an epoch shows."""
        key = np.random.SeedSequence(self._seed, spawn_key=(epoch, RENEWING))
        return replace(self._config, seed=int(key.generate_state(1, np.uint64)[0]))

    def labyrinths(self, epoch: int) -> Iterator[Labyrinth]:
        """Yield the labyrinths of an epoch."""
        return islice(draw_labyrinths(self.config_of(epoch), "train"), self.count)

    def renewed(self, problem: Problem, epoch: int) -> Problem:
        """Return a problem with the labyrinths of an epoch, from 0 on, and their demonstrations."""
        config, drawn = self.config_of(epoch), list(self.labyrinths(epoch))
        shown = [solve(config, "train", each).episodes for each in drawn]
        routes = [[np.array(each.actions, np.int64) for each in episodes] for episodes in shown]
        arrays = as_arrays(drawn, self._spec, routes)

        def exploration() -> Steps:
            walks = [
                (start, np.array(each.actions, np.int64))
                for start, labyrinth in zip(arrays.initial.tolist(), drawn, strict=True)
                for each in solve(config, "random", labyrinth).episodes
            ]
            starts, actions = zip(*walks, strict=True)
            return steps_along(arrays, np.array(starts), actions)

        return replace(
            problem,
            arrays=arrays,
            observations=Observations(arrays.observations, problem.device),
            demonstrations=steps_along(arrays, arrays.route_starts, arrays.routes),
            exploration=exploration,
        )

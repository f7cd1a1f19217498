"""Environments whose seeds choose the level, which Gymnasium and Labyrinth leave to their user."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gymnasium
import numpy as np
from gymnasium.envs.toy_text.frozen_lake import FrozenLakeEnv, generate_random_map
from numpy.typing import NDArray

from labyrinth_core.env import LabyrinthEnv
from labyrinth_core.env.environment import Observation

TEST = 1_000_000
"""The first seed of test."""


class FrozenLakeOfSeed(FrozenLakeEnv):
    """FrozenLake without slipping, in which a seed generates the map and not the environment.

    `gymnasium.make` fixes the map of all episodes. A user who trains on several maps generates
    them by `generate_random_map(size, seed=seed)`, as is done here.
    """

    def __init__(self, size: int) -> None:
        """Make an environment with square maps; `size` is the number of cells on a side."""
        self.size = size
        super().__init__(desc=generate_random_map(size, seed=0), is_slippery=False)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[int, dict[str, Any]]:
        """Begin an episode in the map of a seed, or in the same map without a seed."""
        if seed is not None:
            desc = generate_random_map(self.size, seed=seed)
            super().__init__(desc=desc, is_slippery=False)
        return super().reset(seed=seed, options=options)


def map_of(env: Any) -> NDArray[np.bytes_]:
    """Return the map of FrozenLake, in which every episode begins in the same cell."""
    desc: NDArray[np.bytes_] = env.unwrapped.desc
    return desc


class LabyrinthOfTwoSplits(LabyrinthEnv):
    """Labyrinths of the split train for seeds below `TEST`, else of the split test."""

    def reset(
        self, *, seed: int | None = None, options: Mapping[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin an episode in a labyrinth of the split to which the seed belongs."""
        if seed is not None:
            split = "train" if seed < TEST else "test"
            self._sources = [source._replace(split=split) for source in self._sources]
        return super().reset(seed=seed, options=options)


class CrafterOfSeed(gymnasium.Env[NDArray[np.uint8], np.int64]):
    """Crafter, which takes its seed when it is made, and has the interface of an older gym."""

    def __init__(self) -> None:
        """Make the spaces; `reset` makes the world."""
        from crafter import Env

        self.action_space = gymnasium.spaces.Discrete(Env().action_space.n)
        self._env: Any = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.uint8], dict[str, Any]]:
        """Make the world of a seed; there are no options."""
        from crafter import Env

        del options
        self._env = Env(seed=seed)
        return self._env.reset(), {}

    def step(self, action: np.int64) -> tuple[NDArray[np.uint8], float, bool, bool, dict[str, Any]]:
        """Take a step."""
        observation, reward, done, info = self._env.step(action)
        return observation, reward, done, False, info


for cells in (4, 8):
    gymnasium.register(f"FrozenLake{cells}x{cells}-v0", FrozenLakeOfSeed, kwargs={"size": cells})
for cells in (3, 4, 5):
    given = {"size": cells, "observation": "vector"}
    gymnasium.register(f"Labyrinth{cells}x{cells}-v0", LabyrinthEnv, kwargs=given)
    gymnasium.register(f"TwoSplits{cells}x{cells}-v0", LabyrinthOfTwoSplits, kwargs=given)
gymnasium.register("Crafter-v0", CrafterOfSeed)

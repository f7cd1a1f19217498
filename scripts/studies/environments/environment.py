"""The environments to compare, with their experts."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from math import fsum
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from environments.experts import expert_of
from labyrinth_core.data import DatasetConfig
from labyrinth_core.pictures.vector import vector_observation
from labyrinth_core.world import Action, Solver, sample_labyrinth

Floats = NDArray[np.float64]

LABYRINTH = "Labyrinth"


@dataclass(frozen=True, eq=False)
class Trajectory:
    """One episode of an expert."""

    states: Floats
    """The T + 1 observations, shape (T + 1, dimensions)."""
    actions: NDArray[np.int64] | Floats
    """The T actions, shape (T,) if they are discrete, otherwise (T, dimensions)."""
    total: float
    """The sum of the rewards."""


@dataclass(frozen=True)
class Environment:
    """An environment with its expert, ready to play."""

    play: Callable[[int], Trajectory]
    """Seed -> the expert's episode from the seed's initial state."""
    actions: int | tuple[Floats, Floats]
    """The number of discrete actions, or the bounds of continuous ones."""
    on_map: Callable[[Floats], Floats]
    """States (n, dimensions) -> their coordinates on a map of visits, across and up, (n, 2)."""


@dataclass(frozen=True)
class Facts:
    """The map of visits of an environment, and the figures that the original reports for it."""

    labels: tuple[str, str]
    """The labels of a map of visits, across and up."""
    shown: tuple[int, int]
    """The dimensions of the state on that map; unused for labyrinths, where it shows cells."""
    reported: tuple[float, float, float, float]
    """The original's average reward, action and trajectory difference, and p-value (table 6)."""


FACTS = {
    LABYRINTH: Facts(("column", "row"), (0, 0), (0.9535, 0.0165, 0.0475, 0.000)),
    "MountainCar-v0": Facts(("position", "velocity"), (0, 1), (-101.1170, 0.0093, 0.0035, 0.011)),
    "CartPole-v1": Facts(("position", "angle"), (0, 2), (500.0, 0.0, 0.0037, 0.000)),
    "Hopper-v5": Facts(("angle", "height"), (1, 0), (3530.6376, 0.0007, 0.0023, 0.924)),
    "Walker2d-v5": Facts(("angle", "height"), (1, 0), (4713.9521, 0.0005, 0.0016, 1.000)),
    "HalfCheetah-v5": Facts(("angle", "height"), (1, 0), (9526.0863, 0.0014, 0.0103, 0.254)),
}
"""Environment -> its facts: labyrinths, and environments of Gymnasium."""


def environment_of(name: str, dataset: DatasetConfig) -> Environment:
    """Return an environment with its expert.

    Args:
        name: One of `FACTS`.
        dataset: Size, task and sampler of the labyrinths.

    Raises:
        LabyrinthError: Labyrinths of this size cannot hold the task.
        ImportError: MuJoCo is missing.
    """
    return _labyrinths(dataset) if name == LABYRINTH else _gymnasium(name)


def _labyrinths(config: DatasetConfig) -> Environment:
    """Return labyrinths with the solver; a seed gives the same labyrinth as in `LabyrinthEnv`."""
    size = config.height, config.width

    def play(seed: int) -> Trajectory:
        rng = np.random.default_rng(seed)
        labyrinth = sample_labyrinth(
            *size, config.task, rng, algorithm=config.sampler, open_walls=config.open_walls
        )
        episode = labyrinth.replay(Solver(labyrinth).shortest_route(rng))
        states = [vector_observation(labyrinth, state) for state in episode.states]
        total = float(episode.rewards.sum(dtype=np.float64))
        return Trajectory(np.array(states, np.float64), episode.actions.astype(np.int64), total)

    def on_map(states: Floats) -> Floats:
        rows, columns = np.divmod(states[:, 0], 2 * config.width - 1)
        return np.stack([columns, rows], axis=1) / 2

    play(0)  # Raises an error if labyrinths of this size cannot hold the task.
    return Environment(play, len(Action), on_map)


def _gymnasium(name: str) -> Environment:
    if name not in ("MountainCar-v0", "CartPole-v1"):
        quiet_mujoco()
    env: Any = gymnasium.make(name)
    expert = expert_of(name)
    space: Any = env.action_space
    discrete = hasattr(space, "n")

    def act(observation: Floats) -> Any:
        action = expert(observation)
        return action if discrete else np.minimum(np.maximum(action, space.low), space.high)

    def play(seed: int) -> Trajectory:
        observation, _ = env.reset(seed=seed)
        states, actions, rewards, over = [observation], [], [], False
        while not over:
            actions.append(act(np.asarray(states[-1], np.float64)))
            observation, reward, terminated, truncated, _ = env.step(actions[-1])
            states.append(observation)
            rewards.append(float(reward))
            over = terminated or truncated
        return Trajectory(np.array(states, np.float64), np.array(actions), fsum(rewards))

    return Environment(
        play,
        int(space.n) if discrete else (space.low, space.high),
        lambda states: states[:, FACTS[name].shown],
    )


def quiet_mujoco() -> None:
    """Keep MuJoCo from writing a log of warnings into the working directory."""
    import mujoco

    def warn(message: str) -> None:
        if "deprecated" not in message:  # Gymnasium's models cause this warning each time.
            warnings.warn(f"MuJoCo: {message}", RuntimeWarning, stacklevel=2)

    mujoco.set_mju_user_warning(warn)

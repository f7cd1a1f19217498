"""Environments with another interface than Gymnasium's, in which a seed chooses the level.

Those of VAGEN, RAGEN and OpenEnv come from clones of their repositories, which are in PYTHONPATH
(of OpenEnv the folder `envs`); Jumanji and reasoning-gym come from pip.
"""

from __future__ import annotations

import asyncio
import sys
from collections.abc import Mapping
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

import gymnasium
import numpy as np
from gymnasium.spaces import Discrete
from omegaconf import OmegaConf

from environments.generated import TEST

Begun = tuple[Any, dict[str, Any]]
Stepped = tuple[Any, float, bool, bool, dict[str, Any]]

VAGEN = {
    "Sokoban": ("sokoban.sokoban_env", "sokoban/train_sokoban_free_wm_text.yaml"),
    "FrozenLake": ("frozenlake.frozenlake_env", "frozenlake/train_frozenlake_text.yaml"),
}
"""Class of VAGEN -> its module, and the file with which it is trained on texts."""
RAGEN = {"Sokoban": "sokoban", "FrozenLake": "frozen_lake"}
"""Name of an environment of RAGEN -> its package."""


class Vagen(gymnasium.Env[Any, Any]):
    """An environment of VAGEN, as the file with which it trains on texts sets it."""

    WORDS = ("up", "down", "left", "right")

    def __init__(self, name: str) -> None:
        """Make the environment; `name` is Sokoban or FrozenLake."""
        module, file = VAGEN[name]
        settings = OmegaConf.load(clone_of("vagen") / "examples/train" / file).envs[0].config
        of = getattr(import_module(f"vagen.envs.{module}"), name)
        self._env = of(OmegaConf.to_container(settings))
        self._loop = asyncio.new_event_loop()
        self.action_space = Discrete(len(self.WORDS))

    def reset(self, *, seed: int | None = None, options: Mapping[str, Any] | None = None) -> Begun:
        """Begin an episode in the level of a seed; there are no options."""
        del options
        seen, info = self._loop.run_until_complete(self._env.reset(seed))
        return seen["obs_str"], info

    def step(self, action: Any) -> Stepped:
        """Take a step by the answer of a language model."""
        parts = (f"<answer>{self.WORDS[action]}</answer>", "<prediction>.</prediction>")
        answer = "".join(("<observation>.</observation><think>.</think>", *parts))
        seen, reward, done, info = self._loop.run_until_complete(self._env.step(answer))
        return seen["obs_str"], float(reward), bool(done), False, info

    def close(self) -> None:
        """Close the loop."""
        self._loop.close()


class Ragen(gymnasium.Env[Any, Any]):
    """An environment of RAGEN, as its files of settings set it."""

    def __init__(self, name: str) -> None:
        """Make the environment, without importing the packages above it, which need PyTorch."""
        folder, package = clone_of("ragen"), RAGEN[name]
        for parent in ("ragen", "ragen.env", f"ragen.env.{package}"):
            bare = sys.modules.setdefault(parent, ModuleType(parent))
            bare.__path__ = [str(folder / parent.replace(".", "/"))]
        module = import_module(f"ragen.env.{package}.env")
        files = ["envs.yaml"] + ["_3_frozen_lake.yaml"] * (name == "FrozenLake")
        loaded = [OmegaConf.load(folder / "config" / file).custom_envs for file in files]
        settings = OmegaConf.merge(*(each[f"Coord{name}"].env_config for each in loaded))
        config = getattr(module, f"{name}EnvConfig")(**OmegaConf.to_container(settings))
        self._env = getattr(module, f"{name}Env")(config)
        self.action_space = Discrete(4, start=1)

    def reset(self, *, seed: int | None = None, options: Mapping[str, Any] | None = None) -> Begun:
        """Begin an episode in the level of a seed; there are no options."""
        del options
        return self._env.reset(seed=seed), {}

    def step(self, action: Any) -> Stepped:
        """Take a step."""
        seen, reward, done, info = self._env.step(int(action))
        return seen, float(reward), bool(done), False, info


class JumanjiMaze(gymnasium.Env[Any, Any]):
    """Jumanji's maze of 10x10 cells."""

    def __init__(self) -> None:
        """Compile the environment."""
        import jax
        import jumanji

        env = jumanji.make("Maze-v0")
        self._key = jax.random.PRNGKey
        self._reset, self._step = jax.jit(env.reset), jax.jit(env.step)
        self.action_space = Discrete(env.action_spec.num_values)

    def reset(self, *, seed: int | None = None, options: Mapping[str, Any] | None = None) -> Begun:
        """Begin an episode in the maze of a seed; there are no options."""
        del options
        self._state, begun = self._reset(self._key(seed))
        return self._seen(begun), {}

    def step(self, action: Any) -> Stepped:
        """Take a step; the limit of steps is told as an end."""
        self._state, begun = self._step(self._state, action)
        return self._seen(begun), float(begun.reward), bool(begun.last()), False, {}

    @staticmethod
    def _seen(timestep: Any) -> Any:
        seen = timestep.observation
        places = [*seen.agent_position, *seen.target_position, seen.step_count]
        return {"walls": np.asarray(seen.walls), "places": np.array([int(each) for each in places])}


class ReasoningMaze(gymnasium.Env[Any, Any]):
    """The mazes of reasoning-gym, as its training script makes train and validation data.

    `training/train_grpo.py` trains on `create_dataset("composite", seed=1)`, and validates on the
    same with `seed=2`. Here, seed n below `TEST` is item n of train, and `TEST` + n that of
    validation. An episode has no step.
    """

    SIZE = 20_000

    def __init__(self) -> None:
        """Make both datasets, of mazes alone."""
        import reasoning_gym
        from reasoning_gym.composite import DatasetSpec

        mazes = [DatasetSpec(name="maze", weight=1, config={})]
        self._datasets = [
            reasoning_gym.create_dataset("composite", seed=seed, size=self.SIZE, datasets=mazes)
            for seed in (1, 2)
        ]
        self.action_space = Discrete(1)

    def reset(self, *, seed: int | None = None, options: Mapping[str, Any] | None = None) -> Begun:
        """Return the question that a seed stands for; there are no options."""
        del options
        place = seed or 0
        return self._datasets[place >= TEST][place % TEST]["question"], {}

    def step(self, action: Any) -> Stepped:
        """End the episode."""
        del action
        return "", 0.0, True, False, {}


class OpenEnvMaze(gymnasium.Env[Any, Any]):
    """The maze of OpenEnv with its default arguments."""

    def __init__(self) -> None:
        """Make the environment, without its server."""
        module = import_module("maze_env.server.maze_env_environment")
        self._env = module.MazeEnvironment()
        self._action = import_module("maze_env.models").MazeAction
        self.action_space = Discrete(4)

    def reset(self, *, seed: int | None = None, options: Mapping[str, Any] | None = None) -> Begun:
        """Begin an episode with a seed; there are no options."""
        del options
        return self._env.reset(seed=seed).model_dump(), {}

    def step(self, action: Any) -> Stepped:
        """Take a step."""
        seen = self._env.step(self._action(action=int(action)))
        return seen.model_dump(), float(seen.reward), bool(seen.done), False, {}


def clone_of(package: str) -> Path:
    """Return the folder of the repository that has a package, without importing it."""
    for folder in map(Path, sys.path):
        if (folder / package / "__init__.py").exists():
            return folder
    raise ModuleNotFoundError(f"{package}: add its repository to PYTHONPATH")


def room_of(env: Any) -> Any:
    """Return all cells of Sokoban, before and behind the boxes and the player."""
    room = getattr(env.unwrapped._env, "env", env.unwrapped._env)
    return room.room_fixed, room.room_state


def lake_of(env: Any) -> Any:
    """Return the map of FrozenLake and the player's place."""
    lake = getattr(env.unwrapped._env, "gym_env", env.unwrapped._env)
    return lake.desc, int(lake.s)


def maze_of(env: Any) -> Any:
    """Return the cells of a maze of POPGym, and the agent's place."""
    maze = env.unwrapped
    return maze.maze.grid, tuple(map(int, maze.position))


for game in VAGEN:
    gymnasium.register(f"VAGEN-{game}-v0", Vagen, kwargs={"name": game})
for game in RAGEN:
    gymnasium.register(f"RAGEN-{game}-v0", Ragen, kwargs={"name": game})
gymnasium.register("Jumanji-Maze-v0", JumanjiMaze)
gymnasium.register("ReasoningGym-Maze-v0", ReasoningMaze)
gymnasium.register("OpenEnv-Maze-v0", OpenEnvMaze)

r"""Train PPO and DQN of Stable-Baselines3 on the environment, one run after another, resumable.

    python run.py size=3 stages=build && python run.py size=5 stages=build
    pip install stable-baselines3
    python scripts/studies/reinforce.py --sizes 3 5 --seeds 0 1 2

A run learns from a fixed set, the labyrinths of train, or from fresh ones, which every reset
samples as those of train were sampled: structures that belong to validation or test are drawn
again. At equal numbers of steps the greedy policy is evaluated on the splits. Each finished run
leaves a file such as `5x5-ppo-fresh-seed0.json`, and a run that has one is skipped.

The policy observes the vector of the environment, of which `Centred` makes what the network sees.
From one-hot positions and the wall grid, PPO hardly learns at 5x5 in 300,000 steps.
"""

from __future__ import annotations

import argparse
import json
import platform
import time
from collections.abc import Callable
from itertools import product
from math import isqrt
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import stable_baselines3
import torch
from stable_baselines3 import DQN, PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from stable_baselines3.common.vec_env import DummyVecEnv

from labyrinth_core import LabyrinthEnv
from labyrinth_core.data.buckets import split_of
from labyrinth_core.data.manifest import Manifest
from labyrinth_core.data.storage import write_text
from labyrinth_core.evaluation.answers import Player
from labyrinth_core.evaluation.labyrinth_arrays import LabyrinthArrays, load_arrays
from labyrinth_core.evaluation.scores import score
from labyrinth_core.pictures.vector import WALL
from labyrinth_core.world.labyrinth import Labyrinth, Task
from labyrinth_core.world.random_labyrinth import sample_labyrinth

ALGORITHMS: dict[str, Any] = {"ppo": PPO, "dqn": DQN}
SPLITS = ("train", "validation", "test")
LABYRINTHS = ("fixed", "fresh")
CHECKPOINTS = 20
STEPS = {"ppo": {3: 160_000, 5: 960_000}, "dqn": {3: 48_000, 5: 192_000}}
"""The steps of a run, by algorithm and size."""
ENVIRONMENTS = 32
NETWORK = [128, 128]
SETTINGS: dict[str, dict[str, Any]] = {
    "ppo": {"gamma": 0.95, "learning_rate": 1e-3, "n_steps": 64, "batch_size": 512}
    | {"n_epochs": 4, "ent_coef": 0.01},
    "dqn": {"gamma": 0.95, "learning_rate": 1e-3, "learning_starts": 5_000, "batch_size": 256}
    | {"train_freq": 1, "gradient_steps": 4, "buffer_size": 100_000}
    | {"target_update_interval": 2_000, "exploration_fraction": 0.3},
}
"""Judged by SPL on validation alone; all others are the defaults of Stable-Baselines3."""


class Centred(BaseFeaturesExtractor):
    """The passages around the agent, which is in the middle, and where agent and goal are."""

    def __init__(self, observation_space: gymnasium.spaces.Box) -> None:
        entries = observation_space.shape[0] - 3
        side = isqrt(entries)
        super().__init__(observation_space, 2 * entries + (2 * side - 1) ** 2 // 2)
        self.entries, self.side = entries, side
        window = torch.arange(2 * side - 1)
        # Where each entry of the window lies in the padded grid, seen from the window's corner.
        # Every other one is a passage; the rest are cells and corners, which never change.
        self.window = (window[:, None] * (3 * side - 2) + window).flatten()[1::2]

    def forward(self, observations: torch.Tensor) -> torch.Tensor:
        """Return the features, shape (B, features_dim), of vectors of shape (B, 3 + entries)."""
        agent, _, goal = observations[:, :3].long().unbind(1)
        walls = observations[:, 3:].unflatten(1, (self.side, self.side))
        padded = torch.nn.functional.pad(walls, [self.side - 1] * 4, value=WALL).flatten(1)
        corner = agent // self.side * (3 * self.side - 2) + agent % self.side
        seen = padded.gather(1, corner[:, None] + self.window)
        places = torch.nn.functional.one_hot(torch.stack([agent, goal], 1), self.entries)
        return torch.cat([seen, places.flatten(1)], dim=1)


class Drawn(gymnasium.Wrapper[Any, Any, Any, Any]):
    """Each episode is in a labyrinth that a function draws with the environment's generator."""

    def __init__(self, env: LabyrinthEnv, draw: Callable[[np.random.Generator], Labyrinth]) -> None:
        super().__init__(env)
        self.draw = draw

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        if seed is not None:
            super().reset(seed=seed)
        return super().reset(options={**(options or {}), "labyrinth": self.draw(self.np_random)})


class Evaluations(BaseCallback):
    """Evaluates the greedy policy on the splits every so many steps."""

    def __init__(self, splits: dict[str, LabyrinthArrays], every: int) -> None:
        super().__init__()
        self.splits, self.every = splits, every
        self.found: list[dict[str, Any]] = []
        self.seconds = 0.0
        """The processor's time that evaluations took."""

    def _on_step(self) -> bool:
        if self.num_timesteps >= self.every * (len(self.found) + 1):
            begun = time.process_time()
            act = Player.of(self.model, 0).act
            scores = {name: score(act, arrays) for name, arrays in self.splits.items()}
            figures = {name: {"sr": each.sr, "spl": each.spl} for name, each in scores.items()}
            self.found.append({"steps": self.num_timesteps, **figures})
            self.seconds += time.process_time() - begun
            spl = figures["validation"]["spl"]
            print(f"  {self.num_timesteps:,} steps: SPL on validation {spl:.2f}", flush=True)
        return True


def main() -> None:
    """Train and evaluate all runs that have no file yet."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sizes", type=int, nargs="+", choices=[3, 5], default=[3, 5])
    parser.add_argument("--seeds", type=int, nargs="+", default=[0])
    parser.add_argument("--algorithms", nargs="+", choices=ALGORITHMS, default=list(ALGORITHMS))
    parser.add_argument("--labyrinths", nargs="+", choices=LABYRINTHS, default=LABYRINTHS)
    parser.add_argument("--dataset", type=Path, default=Path("data/labyrinth"))
    parser.add_argument("--results", type=Path, default=Path("docs/results/reinforcement"))
    given = parser.parse_args()
    torch.set_num_threads(1)
    runs = product(given.seeds, given.sizes, given.algorithms, given.labyrinths)
    for seed, size, algorithm, labyrinths in runs:
        path = given.results / f"{size}x{size}-{algorithm}-{labyrinths}-seed{seed}.json"
        if not path.exists():
            print(path.stem, flush=True)
            found = run(given.dataset, size, algorithm, labyrinths, seed)
            path.parent.mkdir(parents=True, exist_ok=True)
            write_text(path, json.dumps(found, indent=1) + "\n")


def run(dataset: Path, size: int, algorithm: str, labyrinths: str, seed: int) -> dict[str, Any]:
    """Return the description of a run and its figures at each checkpoint, in plain types."""
    config = f"{size}x{size}"
    manifest = Manifest.read(dataset / config)
    splits = {name: load_arrays(dataset, config, name, observation="vector") for name in SPLITS}
    train = list(splits["train"].labyrinths)

    def draw(rng: np.random.Generator) -> Labyrinth:
        if labyrinths == "fixed":
            return train[rng.integers(len(train))]
        while True:
            labyrinth = sample_labyrinth(size, size, Task.NAVIGATION, rng)
            if split_of(labyrinth.structure, manifest.config.buckets) == "train":
                return labyrinth

    def environment() -> gymnasium.Env[Any, Any]:
        return Drawn(LabyrinthEnv(size, observation="vector"), draw)

    envs = DummyVecEnv([environment] * ENVIRONMENTS)
    steps, settings = STEPS[algorithm][size], SETTINGS[algorithm]
    network = {"features_extractor_class": Centred, "net_arch": NETWORK}
    model = ALGORITHMS[algorithm](
        "MlpPolicy", envs, policy_kwargs=network, seed=seed, device="cpu", **settings
    )
    evaluations = Evaluations(splits, steps // CHECKPOINTS)
    elapsed, used = time.perf_counter(), time.process_time()
    model.learn(steps, callback=evaluations)
    about = {"method": algorithm.upper(), "config": config, "labyrinths": labyrinths, "seed": seed}
    about |= {"fingerprint": manifest.fingerprint, "observation": "vector", "steps": steps}
    about |= {"environments": ENVIRONMENTS, "network": NETWORK, "settings": settings}
    modules = (stable_baselines3, torch, gymnasium, np)
    return {
        "run": about,
        "versions": {"python": platform.python_version()}
        | {module.__name__: str(module.__version__) for module in modules},
        "seconds_of_training": round(time.process_time() - used - evaluations.seconds, 1),
        "seconds_elapsed": round(time.perf_counter() - elapsed, 1),
        "checkpoints": evaluations.found,
    }


if __name__ == "__main__":
    main()

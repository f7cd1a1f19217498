r"""Train linear policies for MuJoCo by augmented random search, on one core, resumable.

    python scripts/studies/train_experts.py HalfCheetah-v5 --folder experts
    python scripts/studies/train_experts.py Walker2d-v5 --after 218 --bonus 1.7 \
        --noise 0.02 --step-size 0.02

The second changes the settings after 218 iterations: it subtracts more from the reward of each
step, so that a fall costs less beside what speed brings, where the authors' settings only make a
slow gait safer.

Each iteration leaves a checkpoint, so that the same command goes on where it was stopped, with the
same result as if it had not been. `experts/HalfCheetah-v5.json` is the best policy so far, by its
mean return on seeds that are neither the search's nor the analysis's; the one kept in
`pipeline/studies/environments/experts/` is a copy of it.

The search tries random directions and needs no gradients: Mania, Guy and Recht, "Simple random
search of static linear policies is competitive for reinforcement learning", NeurIPS 2018,
algorithm 2, version V2-t.
"""

from __future__ import annotations

import argparse
import json
import platform
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from labyrinth_core.data.storage import write_text
from pipeline.studies.environments.environment import quiet_mujoco

FIRST_SEED = 2**32
"""The least seed of the search's episodes; those below are left for evaluation."""

Play = Callable[[NDArray[np.float64], NDArray[np.float64], int], tuple[float, NDArray[np.float64]]]
"""`(gain, bias, seed)` -> return and observations, shape (T, observation), of one episode.

The policy is `gain @ observation + bias`.
"""


@dataclass(frozen=True)
class Settings:
    """The hyperparameters of the search."""

    step_size: float
    directions: int
    noise: float
    top: int
    """The number of best directions of which a step is made."""


@dataclass(frozen=True)
class Search:
    """The state of a search between two iterations."""

    seed: int
    iteration: int
    weights: NDArray[np.float64]
    """The weights of the policy on normalised observations, shape (action, observation)."""
    count: int
    """The number of observations so far, of which `mean` and `squares` are statistics."""
    mean: NDArray[np.float64]
    """Shape (observation,)."""
    squares: NDArray[np.float64]
    """The sum of squared distances from the mean, shape (observation,)."""

    @classmethod
    def start(cls, seed: int, actions: int, observations: int) -> Search:
        """Return a search without observations, whose policy always answers zero."""
        zeros = np.zeros(observations)
        return cls(seed, 0, np.zeros((actions, observations)), 0, zeros, zeros)

    def policy(
        self, weights: NDArray[np.float64] | None = None
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return gain and bias for unnormalised observations, of the given weights or its own."""
        weights = self.weights if weights is None else weights
        if not self.count:
            return weights, np.zeros(len(weights))
        deviation = np.sqrt(self.squares / self.count)
        # A dimension that never changed carries no information, so it has no weight.
        scale = np.divide(1, deviation, out=np.zeros_like(deviation), where=deviation > 1e-7)
        gain = weights * scale
        return gain, -gain @ self.mean


def improve(search: Search, settings: Settings, play: Play) -> Search:
    """Return the search after one iteration, which is deterministic."""
    rng = np.random.default_rng([search.seed, search.iteration])
    directions = rng.standard_normal((settings.directions, *search.weights.shape))
    seeds = rng.integers(FIRST_SEED, 2**63, size=settings.directions)
    returns = np.empty((settings.directions, 2))
    after = search
    for index, direction in enumerate(directions):
        for side, sign in enumerate((1, -1)):
            policy = search.policy(search.weights + sign * settings.noise * direction)
            # Both sides start in the same state, so that only the direction makes a difference.
            returns[index, side], observations = play(*policy, int(seeds[index]))
            after = _observe(after, observations)
    best = np.argsort(-returns.max(axis=1), kind="stable")[: settings.top]
    deviation = returns[best].std()
    weights = search.weights
    if deviation > 0:
        differences = returns[best, 0] - returns[best, 1]
        step = np.tensordot(differences, directions[best], axes=1)
        weights = weights + settings.step_size / (settings.top * deviation) * step
    return replace(after, iteration=search.iteration + 1, weights=weights)


def _observe(search: Search, observations: NDArray[np.float64]) -> Search:
    """Return the search with observations added to its statistics (Chan et al., 1979)."""
    added = len(observations)
    count = search.count + added
    mean = observations.mean(axis=0)
    shift = mean - search.mean
    squares = ((observations - mean) ** 2).sum(axis=0)
    return replace(
        search,
        count=count,
        mean=search.mean + shift * added / count,
        squares=search.squares + squares + shift**2 * search.count * added / count,
    )


SETTINGS = {
    "HalfCheetah-v5": (Settings(step_size=0.02, directions=32, noise=0.03, top=4), 0.0),
    "Hopper-v5": (Settings(step_size=0.01, directions=8, noise=0.025, top=4), 1.0),
    "Walker2d-v5": (Settings(step_size=0.03, directions=40, noise=0.025, top=30), 1.0),
}
"""The authors' settings for V2-t, and the reward for being alive that is subtracted."""

HORIZON = 1000
"""The number of steps of a whole episode."""

JUDGES = range(2**31, 2**31 + 20)
"""The seeds of the episodes by which the best policy is chosen."""


@cache
def player(name: str, bonus: float, horizon: int = HORIZON) -> Play:
    """Return the function that plays an episode, and subtracts the bonus from each reward."""
    # Unwrapped: the horizon is counted here, and the wrappers' checks are not needed.
    env: Any = gymnasium.make(name).unwrapped
    low, high = env.action_space.low, env.action_space.high

    def play(
        gain: NDArray[np.float64], bias: NDArray[np.float64], seed: int
    ) -> tuple[float, NDArray[np.float64]]:
        observation, _ = env.reset(seed=seed)
        observations, total = [observation], 0.0
        for _ in range(horizon):
            action = np.minimum(np.maximum(gain @ observation + bias, low), high)
            observation, reward, terminated, _, _ = env.step(action)
            total += reward - bonus
            if terminated:
                break
            observations.append(observation)
        return total, np.array(observations)

    return play


def main() -> None:
    """Train one policy."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("environment", choices=SETTINGS)
    parser.add_argument("--folder", type=Path, default=Path("experts"))
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--iterations", type=int, default=300)
    parser.add_argument("--every", type=int, default=5, help="iterations between two evaluations")
    parser.add_argument("--horizon", type=int, default=HORIZON, help="most steps while searching")
    for name, kind in (("step_size", float), ("directions", int), ("noise", float), ("top", int)):
        parser.add_argument(_flag(name), type=kind, help="another value than the authors'")
    parser.add_argument("--bonus", type=float, help="subtracted from each reward")
    parser.add_argument(
        "--after", type=int, default=0, help="iterations with the authors' settings"
    )
    train(parser.parse_args())


def _flag(name: str) -> str:
    return f"--{name.replace('_', '-')}"


def settings_of(arguments: argparse.Namespace, iteration: int) -> tuple[Settings, float]:
    """Return the settings of an iteration, and the bonus: the authors', or those given."""
    settings, bonus = SETTINGS[arguments.environment]
    if iteration < arguments.after:
        return settings, bonus
    given = {name: getattr(arguments, name) for name in vars(settings)}
    changed = {name: value for name, value in given.items() if value is not None}
    return replace(settings, **changed), bonus if arguments.bonus is None else arguments.bonus


def train(arguments: argparse.Namespace) -> None:
    """Continue the search up to its last iteration."""
    name = arguments.environment
    arguments.folder.mkdir(parents=True, exist_ok=True)
    stem = arguments.folder / f"{name}-seed{arguments.seed}"
    checkpoint, kept = stem.with_suffix(".npz"), arguments.folder / f"{name}.json"
    quiet_mujoco()
    judge = player(name, 0.0)
    search = load(checkpoint) if checkpoint.exists() else fresh(name, arguments.seed)
    best = json.loads(kept.read_text())["return"]["mean"] if kept.exists() else -np.inf
    while search.iteration < arguments.iterations:
        settings, bonus = settings_of(arguments, search.iteration)
        search = improve(search, settings, player(name, bonus, arguments.horizon))
        if search.iteration % arguments.every == 0:
            policy = search.policy()
            returns = np.array([judge(*policy, seed)[0] for seed in JUDGES])
            if returns.mean() > best:
                best = returns.mean()
                description = described(search, returns, arguments)
                write_text(kept, json.dumps(description, indent=1) + "\n")
            line = {"iteration": search.iteration, "steps": search.count}
            line |= {"mean": returns.mean(), "std": returns.std(), "min": returns.min()}
            line |= {"cpu_s": time.process_time()}
            with stem.with_suffix(".log").open("a") as log:
                print(json.dumps(line), file=log)
        save(checkpoint, search)


def fresh(name: str, seed: int) -> Search:
    """Return a search that has not begun."""
    env: Any = gymnasium.make(name)
    return Search.start(seed, env.action_space.shape[0], env.observation_space.shape[0])


def described(
    search: Search, returns: NDArray[np.float64], arguments: argparse.Namespace
) -> dict[str, Any]:
    """Return the policy and its provenance, in plain types."""
    name = arguments.environment
    settings, bonus = settings_of(arguments, search.iteration)
    given = vars(arguments) | {"iterations": search.iteration}
    options = [
        f"{_flag(key)} {value}"
        for key, value in given.items()
        if key not in ("environment", "folder", "every") and value is not None
    ]
    gain, bias = search.policy()
    return {
        "environment": name,
        "gain": gain.tolist(),
        "bias": bias.tolist(),
        "return": {
            "mean": returns.mean(),
            "std": returns.std(),
            "seeds": [JUDGES.start, JUDGES.stop],
        },
        "provenance": {
            "algorithm": "augmented random search, V2-t",
            "command": " ".join(["python scripts/studies/train_experts.py", name, *options]),
            "settings": vars(settings) | {"bonus_taken_away": bonus},
            "steps": search.count,
            "versions": {
                "python": platform.python_version(),
                "numpy": np.__version__,
                "gymnasium": gymnasium.__version__,
                "mujoco": version("mujoco"),
            },
        },
    }


def load(path: Path) -> Search:
    """Return the search that `save` wrote."""
    with np.load(path, allow_pickle=False) as arrays:
        numbers = {name: int(arrays[name]) for name in ("seed", "iteration", "count")}
        rest = {name: arrays[name] for name in ("weights", "mean", "squares")}
        return Search(**numbers, **rest)


def save(path: Path, search: Search) -> None:
    """Write the search; a crash leaves the previous file."""
    partial = path.with_suffix(".partial.npz")
    np.savez(partial, **vars(search))
    partial.replace(path)


if __name__ == "__main__":
    main()

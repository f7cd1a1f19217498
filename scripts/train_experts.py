r"""Train linear policies for MuJoCo by augmented random search, one core, resumable.

    python scripts/train_experts.py HalfCheetah-v5 --folder experts
    python scripts/train_experts.py Walker2d-v5 --after 218 --bonus 1.7 \
        --noise 0.02 --step-size 0.02

The second goes on otherwise after 218 iterations: it takes more away from each step, so that a fall
costs less beside what speed brings, where the authors' settings only make a slow gait safer.

Each iteration leaves a checkpoint, so that the same command goes on where it was stopped, with the
same result as if it had not been. `experts/HalfCheetah-v5.json` is the best policy so far, by its
mean return on seeds that are neither the search's nor the analysis's; the one kept in
`pipeline/analysis/environments/experts/` is a copy of it.
"""

from __future__ import annotations

import argparse
import json
import platform
import time
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import gymnasium
import mujoco
import numpy as np
from numpy.typing import NDArray

from labyrinth_core.data.storage import write_text
from pipeline.analysis.environments.environment import quiet_mujoco
from pipeline.analysis.environments.experts.random_search import Play, Search, Settings, improve

SETTINGS = {
    "HalfCheetah-v5": (Settings(step_size=0.02, directions=32, noise=0.03, top=4), 0.0),
    "Hopper-v5": (Settings(step_size=0.01, directions=8, noise=0.025, top=4), 1.0),
    "Walker2d-v5": (Settings(step_size=0.03, directions=40, noise=0.025, top=30), 1.0),
}
"""Settings that the authors chose for V2-t, and the bonus for being alive that is taken away."""

HORIZON = 1000
"""Steps of a whole episode."""

JUDGES = range(2**31, 2**31 + 20)
"""Seeds of the episodes that say which policy is the best."""


@cache
def player(name: str, bonus: float, horizon: int = HORIZON) -> Play:
    """Return the function that plays an episode, without the bonus of each step."""
    # Bare: the horizon is counted here, and the wrappers' checks are for other people's worlds.
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
    parser.add_argument("--every", type=int, default=5, help="iterations between two judgements")
    parser.add_argument("--horizon", type=int, default=HORIZON, help="most steps while searching")
    for name, kind in (("step_size", float), ("directions", int), ("noise", float), ("top", int)):
        parser.add_argument(_flag(name), type=kind, help="not as its authors")
    parser.add_argument("--bonus", type=float, help="taken away in each step, not as its authors")
    parser.add_argument("--after", type=int, default=0, help="iterations that are as its authors")
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
    """Go on with the search up to its last iteration."""
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
    """Return the search that has not begun."""
    env: Any = gymnasium.make(name)
    return Search.start(seed, env.action_space.shape[0], env.observation_space.shape[0])


def described(
    search: Search, returns: NDArray[np.float64], arguments: argparse.Namespace
) -> dict[str, Any]:
    """Return the policy and where it comes from, in plain types."""
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
            "command": " ".join(["python scripts/train_experts.py", name, *options]),
            "settings": vars(settings) | {"bonus_taken_away": bonus},
            "steps": search.count,
            "versions": {
                "python": platform.python_version(),
                "numpy": np.__version__,
                "gymnasium": gymnasium.__version__,
                "mujoco": mujoco.__version__,
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
    """Write the search; a crash leaves the one before."""
    partial = path.with_suffix(".partial.npz")
    np.savez(partial, **vars(search))
    partial.replace(path)


if __name__ == "__main__":
    main()

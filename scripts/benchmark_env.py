"""Measure how fast the environments are, beside MiniGrid in the same run.

    pip install minigrid
    python scripts/benchmark_env.py [--rounds N] [--quick]

MiniGrid brings pygame-ce, which takes the place of pygame: give it a virtual environment.

In each round everyone is timed once, so that a busy machine slows all of them alike; a ratio is the
median of the rounds' ratios. All take random actions and reset when an episode ends, which is part
of the time. Vector environments first run for as long as an episode can last, so that their
episodes no longer begin and end together. "Kept" labyrinths stay the same from episode to episode,
"fresh" ones are sampled anew for each.

MiniGrid is `MiniGrid-Empty-8x8-v0` as `gymnasium.make` returns it, with its own observation, a
7 x 7 x 3 array of symbols, which is the cheapest that it has and the most similar to a vector. Its
actions are turning left, turning right and going forward. Labyrinths are 8 x 8 as well, except
those of 5x5, the size of the datasets.
"""

from __future__ import annotations

import argparse
import sys
import time
import warnings
from collections.abc import Callable
from functools import partial
from statistics import median
from typing import Any

import gymnasium
import numpy as np
from measuring import machine, ratio, take_turns

from labyrinth_core.world.labyrinth import Task
from labyrinth_core.world.random_labyrinth import sample_labyrinth

MINIGRID = "MiniGrid-Empty-8x8-v0"
LABYRINTH = "labyrinth_core.env:Labyrinth-v0"
NUM_ENVS = 10_000
PICTURE_SIZE = 600

Rate = Callable[[], float]
"""Measures something, and returns how many there are per second."""


def single(env: gymnasium.Env[Any, Any], actions: int, steps: int) -> Rate:
    """Return a function that measures the steps per second of a single environment."""
    choices = np.random.default_rng(0).integers(actions, size=steps).tolist()
    env.reset(seed=0)

    def rate() -> float:
        env.reset()
        start = time.perf_counter()
        for action in choices:
            _, _, terminated, truncated, _ = env.step(action)
            if terminated or truncated:
                env.reset()
        return steps / (time.perf_counter() - start)

    return rate


def vector(size: int, steps: int, *, kept: bool, **arguments: Any) -> Rate:
    """Return a function that measures the steps per second of a vector, over all labyrinths."""
    rng = np.random.default_rng(0)
    labyrinths = [sample_labyrinth(size, size, Task.NAVIGATION, rng) for _ in range(NUM_ENVS)]
    env = gymnasium.make_vec(
        LABYRINTH,
        num_envs=NUM_ENVS,
        size=size,
        labyrinths=labyrinths if kept else None,
        **arguments,
    )
    env.reset(seed=0)
    choices = rng.integers(4, size=(steps, NUM_ENVS))
    for step in range(40 * size * size + 2):
        env.step(choices[step % steps])

    def rate() -> float:
        start = time.perf_counter()
        for actions in choices:
            env.step(actions)
        return steps * NUM_ENVS / (time.perf_counter() - start)

    return rate


def pictures(env: gymnasium.Env[Any, Any], actions: int, count: int) -> Rate:
    """Return a function that measures the pictures per second, with a step before each."""
    choices = np.random.default_rng(0).integers(actions, size=count).tolist()
    env.reset(seed=0)

    def rate() -> float:
        spent = 0.0
        for action in choices:
            _, _, terminated, truncated, _ = env.step(action)
            start = time.perf_counter()
            env.render()
            spent += time.perf_counter() - start
            if terminated or truncated:
                env.reset()
        return count / spent

    return rate


def contestants(scale: int) -> dict[str, tuple[str, int, Rate]]:
    """Return by name: what is compared with, the target ratio, and the measurement."""
    make = partial(gymnasium.make, LABYRINTH)
    steps, batches = 2_000 * scale, 10 * scale
    minigrid = gymnasium.make(MINIGRID)
    drawn = gymnasium.make(MINIGRID, render_mode="rgb_array", tile_size=PICTURE_SIZE // 8)
    lone = "MiniGrid, one environment"
    easel = "MiniGrid, a picture of 600 x 600"
    fast: dict[str, Any] = {"observation": "state"}
    walls: dict[str, Any] = {"observation": "vector"}
    rgb: dict[str, Any] = {"observation": "state", "render_mode": "rgb_array"}
    return {
        lone: ("", 0, single(minigrid, 3, steps)),
        "one environment, vector": (lone, 5, single(make(size=8, **walls), 4, 4 * steps)),
        "one environment, state": (lone, 5, single(make(size=8, **fast), 4, 4 * steps)),
        "10,000 kept 5x5, state": (lone, 1_000, vector(5, 4 * batches, kept=True, **fast)),
        "10,000 kept 5x5, vector": (lone, 200, vector(5, 2 * batches, kept=True, **walls)),
        "10,000 kept 8x8, state": (lone, 1_000, vector(8, 4 * batches, kept=True, **fast)),
        "10,000 kept 8x8, vector": (lone, 200, vector(8, 2 * batches, kept=True, **walls)),
        "10,000 fresh 5x5, state": (lone, 1_000, vector(5, 4 * batches, kept=False, **fast)),
        "10,000 fresh 8x8, state": (lone, 1_000, vector(8, 4 * batches, kept=False, **fast)),
        easel: ("", 0, pictures(drawn, 3, 50 * scale)),
        "a picture of 600 x 600, 8x8": (easel, 0, pictures(make(size=8, **rgb), 4, 200 * scale)),
    }


def report(rates: dict[str, list[float]], against: dict[str, tuple[str, int, Rate]]) -> None:
    """Print the table: the median rate, the median ratio, its range, and the target."""
    print(f"{'':36}{'a second':>14}{'times MiniGrid':>16}{'range':>18}{'to reach':>10}")
    for name, measured in rates.items():
        rival, aim, _ = against[name]
        line = f"{name:36}{median(measured):>14,.0f}"
        if rival:
            middle, extent, verdict = ratio(measured, rates[rival], aim)
            line += f"{middle:>16}{extent:>18}{verdict:>10}"
        print(line)


def main() -> None:
    """Measure and report."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=7, help="rounds; each times everyone once")
    parser.add_argument("--quick", action="store_true", help="short rounds, for a first look")
    arguments = parser.parse_args()
    if arguments.rounds < 1:
        parser.error(f"--rounds {arguments.rounds}: give a whole number from 1 on")
    try:
        import minigrid
    except ImportError:
        sys.exit("This benchmark compares with MiniGrid, which is missing: pip install minigrid")
    gymnasium.register_envs(minigrid)
    warnings.filterwarnings("ignore", module="gymnasium")
    against = contestants(1 if arguments.quick else 5)
    print(f"{machine('numpy', 'gymnasium', 'minigrid')}; {arguments.rounds} rounds")
    rates = {name: rate for name, (_, _, rate) in against.items()}
    report(take_turns(rates, arguments.rounds), against)


if __name__ == "__main__":
    main()

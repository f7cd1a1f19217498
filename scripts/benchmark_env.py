"""How fast the environments are, beside MiniGrid in the same run.

    pip install minigrid
    python scripts/benchmark_env.py [--rounds N] [--quick]

MiniGrid brings pygame-ce, which takes the place of pygame: give it a virtual environment.

Each round times every contestant once, one after the other, so that a busy machine slows all of
them alike; the figure is the median of the rounds' ratios. Every contestant takes random actions
and begins anew where an episode ends, which is part of its time; vectors are first run for as
long as an episode can last, so that their labyrinths no longer begin and end together. "Kept"
labyrinths stay the same from episode to episode, "fresh" ones are drawn anew for each.

MiniGrid is `MiniGrid-Empty-8x8-v0` as `gymnasium.make` gives it, with its own observation, a
7 x 7 x 3 array of symbols: the cheapest it has, and the nearest to a vector of the world. Its
actions are turning left, right and going forward. Labyrinths are 8 x 8 as well, save where it
says 5x5, the size of the datasets.
"""

from __future__ import annotations

import argparse
import os
import platform
import sys
import time
import warnings
from collections.abc import Callable
from functools import partial
from importlib.metadata import version
from statistics import median
from typing import Any

import gymnasium
import numpy as np

from labyrinth_core.world.labyrinth import Task
from labyrinth_core.world.random_labyrinth import sample_labyrinth

MINIGRID = "MiniGrid-Empty-8x8-v0"
LABYRINTH = "labyrinth_core.env:Labyrinth-v0"
NUM_ENVS = 10_000
PICTURE_SIZE = 600

Rate = Callable[[], float]
"""Times something, and returns how many a second."""


def single(env: gymnasium.Env[Any, Any], actions: int, steps: int) -> Rate:
    """Return what measures the steps a second of a single environment."""
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
    """Return what measures the steps a second, of all labyrinths together, of a vector."""
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
    """Return what measures the pictures a second, a step before each."""
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
    """Return what is measured, by name: against what, the ratio to reach, and the measurement."""
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
        "10,000 fresh 5x5, state": (lone, 0, vector(5, batches, kept=False, **fast)),
        "10,000 fresh 8x8, state": (lone, 0, vector(8, batches, kept=False, **fast)),
        easel: ("", 0, pictures(drawn, 3, 50 * scale)),
        "a picture of 600 x 600, 8x8": (easel, 0, pictures(make(size=8, **rgb), 4, 200 * scale)),
    }


def report(rates: dict[str, list[float]], against: dict[str, tuple[str, int, Rate]]) -> None:
    """Print the table: median rate, median ratio, its range, and what was to be reached."""
    print(f"{'':36}{'a second':>14}{'times MiniGrid':>16}{'range':>18}{'to reach':>10}")
    for name, measured in rates.items():
        rival, aim, _ = against[name]
        line = f"{name:36}{median(measured):>14,.0f}"
        if rival:
            ratios = [ours / theirs for ours, theirs in zip(measured, rates[rival], strict=True)]
            extent = f"{min(ratios):,.1f} - {max(ratios):,.1f}"
            verdict = "" if not aim else f"{aim:,}" + ("" if median(ratios) >= aim else " MISSED")
            line += f"{median(ratios):>16,.1f}{extent:>18}{verdict:>10}"
        print(line)


def main() -> None:
    """Measure and report."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=7, help="rounds, each timing everything once")
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
    packages = ", ".join(f"{name} {version(name)}" for name in ("numpy", "gymnasium", "minigrid"))
    print(
        f"{platform.system()} {platform.machine()}, {os.cpu_count()} cores, "
        f"Python {platform.python_version()}, {packages}; {arguments.rounds} rounds"
    )
    rates: dict[str, list[float]] = {name: [] for name in against}
    for _ in range(arguments.rounds + 1):
        for name, (_, _, rate) in against.items():
            rates[name].append(rate())
    # The first round does not count: in it memories fill, such as MiniGrid's of tiles.
    report({name: measured[1:] for name, measured in rates.items()}, against)


if __name__ == "__main__":
    main()

"""Measure how fast the environments are, compared with MiniGrid in the same run.

    pip install minigrid
    python scripts/benchmark_env.py [--rounds N] [--quick]

MiniGrid pins other versions of libraries: use a virtual environment.

In each round every environment is timed once, so that a busy machine slows all of them alike. A
ratio is the median over rounds of the ratio to the last row above that has no ratio. Rates are per
second of CPU time, summed over all threads. All environments take random actions and reset when an
episode ends, which counts. Vector environments first run for the maximum length of an episode, so
that their episodes do not begin and end together. "Kept" labyrinths, all different, stay the same
from episode to episode; "fresh" labyrinths are sampled anew for each episode.

MiniGrid is `MiniGrid-Empty-8x8-v0` as `gymnasium.make` returns it: with its own observation, a
7 x 7 x 3 array of symbols, which is its cheapest and the most similar to a vector, or with its RGB
wrapper, pictures of 64 x 64. Its actions are turning left, turning right and going forward.
Labyrinths are 8 x 8 as well, except those of 5x5, the size of the datasets.
"""

from __future__ import annotations

import sys
import time
import warnings
from collections.abc import Callable
from functools import partial
from itertools import product
from typing import Any

import gymnasium
import numpy as np
from measuring import machine, parser_of, per_second, report, take_turns

from labyrinth_core.pictures.scenes import draw
from labyrinth_core.world import Task, sample_labyrinth

MINIGRID = "MiniGrid-Empty-8x8-v0"
LABYRINTH = "labyrinth_core.env:Labyrinth-v0"
NUM_ENVS = 10_000
PICTURE_SIZE = 600
OBSERVED_SIZE = 64
PICTURED_ENVS = 1_024

Rate = Callable[[], float]
"""Takes a measurement, and returns a rate per second."""


def single(env: gymnasium.Env[Any, Any], actions: int, steps: int) -> Rate:
    """Return a function that measures the steps per second of a single environment."""
    choices = np.random.default_rng(0).integers(actions, size=steps).tolist()
    env.reset(seed=0)

    def work() -> int:
        env.reset()
        for action in choices:
            _, _, terminated, truncated, _ = env.step(action)
            if terminated or truncated:
                env.reset()
        return steps

    return per_second(work)


def vector(size: int, steps: int, *, kept: bool, count: int = NUM_ENVS, **arguments: Any) -> Rate:
    """Return a function that measures the steps per second of a vector environment, in total."""
    rng = np.random.default_rng(0)
    labyrinths = [sample_labyrinth(size, size, Task.NAVIGATION, rng) for _ in range(count)]
    env = gymnasium.make_vec(
        LABYRINTH,
        num_envs=count,
        size=size,
        labyrinths=labyrinths if kept else None,
        **arguments,
    )
    env.reset(seed=0)
    choices = rng.integers(4, size=(steps, count))
    for step in range(40 * size * size + 2):
        env.step(choices[step % steps])

    def work() -> int:
        for actions in choices:
            kept_until_the_next = env.step(actions)
        del kept_until_the_next
        return steps * count

    return per_second(work)


def copying(steps: int) -> Rate:
    """Return a function that measures how many pictures per second are copied, in batches."""
    batch = np.ones((PICTURED_ENVS, OBSERVED_SIZE, OBSERVED_SIZE, 3), np.uint8)

    def work() -> int:
        for _ in range(steps):
            kept_until_the_next = batch.copy()
        del kept_until_the_next
        return steps * PICTURED_ENVS

    return per_second(work)


def all_states(count: int) -> Rate:
    """Return a function that measures labyrinths per second when all their states are drawn."""
    rng = np.random.default_rng(0)
    labyrinths = [sample_labyrinth(5, 5, Task.NAVIGATION, rng) for _ in range(count)]
    views = [[(each, each.state_at(number)) for number in range(25)] for each in labyrinths]

    def work() -> int:
        for of_one in views:
            draw(of_one, OBSERVED_SIZE)
        return count

    return per_second(work)


def pictures(env: gymnasium.Env[Any, Any], actions: int, count: int) -> Rate:
    """Return a function that measures rendered pictures per second, not counting the steps."""
    choices = np.random.default_rng(0).integers(actions, size=count).tolist()
    env.reset(seed=0)

    def rate() -> float:
        spent = 0.0
        for action in choices:
            _, _, terminated, truncated, _ = env.step(action)
            start = time.process_time()
            env.render()
            spent += time.process_time() - start
            if terminated or truncated:
                env.reset()
        return count / spent

    return rate


def contestants(scale: int) -> tuple[dict[str, Rate], dict[str, str]]:
    """Return the measurements by name, and the name of the one that each is compared with."""
    from minigrid.wrappers import RGBImgObsWrapper

    make = partial(gymnasium.make, LABYRINTH)
    steps, batches = 2_000 * scale, 10 * scale
    lone, camera = "MiniGrid, one environment", "MiniGrid, one, pictures of 64 x 64"
    copies, easel = "copying batches of 1,024 pictures", "MiniGrid, a picture of 600 x 600"
    framed = RGBImgObsWrapper(gymnasium.make(MINIGRID), tile_size=OBSERVED_SIZE // 8)
    drawn = gymnasium.make(MINIGRID, render_mode="rgb_array", tile_size=PICTURE_SIZE // 8)
    ours = make(size=8, observation="state", render_mode="rgb_array")
    found: dict[str, Rate] = {lone: single(gymnasium.make(MINIGRID), 3, steps)}
    for kind in ("vector", "state"):
        env = make(size=8, observation=kind)
        found[f"one environment, {kind}"] = single(env, 4, 4 * steps)
    for kept, size, kind in product((True, False), (5, 8), ("state", "vector")):
        if kept or kind == "state":
            name = f"10,000 {'kept' if kept else 'fresh'} {size}x{size}, {kind}"
            count = (4 if kind == "state" else 2) * batches
            found[name] = vector(size, count, kept=kept, observation=kind)
    rivals = dict.fromkeys(list(found)[1:], lone)
    found[camera] = single(framed, 3, steps // 2)
    found["one fresh 5x5, pictures"] = single(make(size=5), 4, 4 * steps)
    rivals["one fresh 5x5, pictures"] = camera
    found["all 25 states of a 5x5, times"] = all_states(40 * scale)
    found[copies] = copying(4 * batches)
    shown = partial(vector, 5, 4 * batches, count=PICTURED_ENVS, observation="image")
    found["1,024 kept 5x5, pictures"] = shown(kept=True)
    found["1,024 kept, copy=False"] = shown(kept=True, copy=False)
    found["1,024 fresh 5x5, pictures"] = shown(kept=False)
    rivals |= dict.fromkeys((name for name in found if name.startswith("1,024")), copies)
    found[easel] = pictures(drawn, 3, 50 * scale)
    found["a picture of 600 x 600, 8x8"] = pictures(ours, 4, 200 * scale)
    rivals["a picture of 600 x 600, 8x8"] = easel
    return found, rivals


def main() -> None:
    """Measure and report."""
    arguments = parser_of(__doc__, rounds=7).parse_args()
    try:
        import minigrid
    except ImportError:
        sys.exit("This benchmark compares with MiniGrid, which is missing: pip install minigrid")
    gymnasium.register_envs(minigrid)
    warnings.filterwarnings("ignore", module="gymnasium")
    rates, rivals = contestants(1 if arguments.quick else 5)
    print(f"{machine('numpy', 'gymnasium', 'minigrid')}; {arguments.rounds} rounds")
    report(take_turns(rates, arguments.rounds), rivals, "a second")


if __name__ == "__main__":
    main()

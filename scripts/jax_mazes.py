"""Measure mazes of JAX libraries for `benchmark_env.py`, which runs this in another environment.

It prints the names of what it can measure, and then, for each name that it reads, the number of
steps a second of CPU time, all threads together. Measured are a number of steps of many
environments with random actions, compiled before, as one program; it returns the sum of all rewards
and observations, so that it has to work them all out.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from typing import Any

import jax

ENVIRONMENTS, STEPS = 1_024, 256

Rollout = Callable[[Any], Any]
"""Goes through all steps, given a key, and returns a sum."""


def navix() -> Rollout:
    """Return a rollout in the empty room of Navix."""
    import navix

    env = navix.make("Navix-Empty-8x8-v0")

    def step(timestep: Any, actions: Any) -> Any:
        timestep = jax.vmap(env.step)(timestep, actions)
        return timestep, timestep.reward.sum() + timestep.observation.sum()

    return rollout(jax.vmap(env.reset), step, 3)


def xland() -> Rollout:
    """Return a rollout in the empty room of XLand-MiniGrid."""
    import xminigrid
    from xminigrid.wrappers import GymAutoResetWrapper

    env, params = xminigrid.make("MiniGrid-Empty-8x8")
    env = GymAutoResetWrapper(env)

    def step(timestep: Any, actions: Any) -> Any:
        timestep = jax.vmap(env.step, (None, 0, 0))(params, timestep, actions)
        return timestep, timestep.reward.sum() + timestep.observation.sum()

    return rollout(jax.vmap(lambda key: env.reset(params, key)), step, 3)


def jumanji() -> Rollout:
    """Return a rollout in mazes of Jumanji, a new one for each episode."""
    import jumanji
    from jumanji.wrappers import VmapAutoResetWrapper

    env = VmapAutoResetWrapper(jumanji.make("Maze-v0"))

    def step(state: Any, actions: Any) -> Any:
        state, timestep = env.step(state, actions)
        return state, timestep.reward.sum() + timestep.observation.walls.sum()

    return rollout(lambda keys: env.reset(keys)[0], step, 4)


def rollout(
    reset: Callable[[Any], Any], step: Callable[[Any, Any], tuple[Any, Any]], actions: int
) -> Rollout:
    """Return a rollout of all environments; a step returns the next states and a sum."""

    def advance(carried: Any, key: Any) -> Any:
        states, total = carried
        states, more = step(states, jax.random.randint(key, (ENVIRONMENTS,), 0, actions))
        return (states, total + more), None

    def run(key: Any) -> Any:
        states = reset(jax.random.split(key, ENVIRONMENTS))
        return jax.lax.scan(advance, (states, 0.0), jax.random.split(key, STEPS))[0][1]

    return run


MAZES = {
    "Navix, empty 8x8, symbols": navix,
    "XLand-MiniGrid, empty 8x8, symbols": xland,
    "Jumanji, fresh mazes of 10x10": jumanji,
}


def main() -> None:
    """Compile all, and answer."""
    key = jax.random.PRNGKey(0)
    compiled = {name: jax.jit(maze()).lower(key).compile() for name, maze in MAZES.items()}
    print(*compiled, sep="\t", flush=True)
    for number, name in enumerate(sys.stdin):
        key = jax.random.PRNGKey(number)
        start = time.process_time()
        compiled[name.strip()](key).block_until_ready()
        print(ENVIRONMENTS * STEPS / (time.process_time() - start), flush=True)


if __name__ == "__main__":
    main()

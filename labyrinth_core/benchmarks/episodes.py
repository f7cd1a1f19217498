"""What is seen of a seed: its first observation, and episodes of fixed actions."""

from __future__ import annotations

import copy
from collections.abc import Callable, Container, Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from labyrinth_core.benchmarks.encoding import Tape, digest, encode
from labyrinth_core.benchmarks.environment import (
    FAILURES,
    CertifyError,
    EnvironmentFailure,
    Maker,
    StateOf,
    called,
    close,
    failure,
)
from labyrinth_core.benchmarks.levels import Ranges

Draw = Callable[[np.random.Generator], Any]
"""Returns a random action of an environment without an action space that can be sampled."""

ACTION_SEED = 0
"""The seed of the action sequences."""
TAPE_BYTES = 1 << 20
"""About how much is kept of what is seen, before it is hashed."""
IMMUTABLE = (int, str, np.generic)
"""Types of actions that an environment cannot change."""


@dataclass(frozen=True)
class Protocol:
    """How an environment is looked at."""

    maker: Maker
    actions: tuple[tuple[Any, ...], ...]
    """The action sequences, one for each probe; none to look at first observations alone."""
    state: StateOf | None = None
    fresh: bool = False
    """Whether each episode gets a new environment."""

    def walk(self, stage: Stage, seed: int) -> Iterator[tuple[Any, Any, Iterable[Any]]]:
        """Yield, for each probe of a seed, the environment, its first observation and the actions.

        The environment is to be stepped before the iteration goes on.

        Raises:
            CertifyError: The environment cannot be made, or is not one of Gymnasium.
            EnvironmentFailure: The environment fails at this seed.
        """
        for actions in self.actions or ((),):
            env = stage.ready()
            result = called(env.reset, seed=seed)
            if not (isinstance(result, tuple) and len(result) == 2):
                raise CertifyError(
                    f"{self.maker.name}: reset(seed=...) returns {type(result).__name__}, not "
                    "(observation, info): record it with examples/record_levels.py instead"
                )
            yield env, result[0], actions if self.immutable else map(copy.copy, actions)

    @cached_property
    def immutable(self) -> bool:
        """Whether the environment cannot change an action."""
        return all(isinstance(each, IMMUTABLE) for actions in self.actions for each in actions)


def steps_of(env: Any, actions: Iterable[Any]) -> Iterator[tuple[Any, Any, Any, Any]]:
    """Yield what each step returns until the episode ends, without the info.

    `Tape.play` takes the same steps. An environment may overwrite what it returned when the
    iteration goes on.

    Raises:
        EnvironmentFailure: The environment fails.
    """
    try:
        for action in actions:
            observation, reward, terminated, truncated, _ = env.step(action)
            ended = bool(terminated or truncated)
            yield observation, reward, terminated, truncated
            if ended:
                return
    except FAILURES as error:
        raise failure(error) from error


class Stage:
    """Holds the environment that episodes are played in, and replaces it after an error."""

    def __init__(self, protocol: Protocol) -> None:
        self.protocol = protocol
        self.env: Any = None

    def ready(self) -> Any:
        """Return an environment to reset: the last one, or a new one."""
        if self.protocol.fresh:
            self.close()
        if self.env is None:
            self.env = self.protocol.maker.make()
        return self.env

    def close(self) -> None:
        """Close the environment; the next one is new."""
        env, self.env = self.env, None
        close(env)


class Seen(NamedTuple):
    """What was seen of one seed, as digests."""

    seed: int
    first: int = 0
    probes: int = 0
    state: int = 0
    steady: bool = True
    """Whether all probes began with the same observation."""
    error: str = ""
    """What ended the episodes, if the environment failed."""


def look(
    protocol: Protocol,
    stage: Stage,
    seeds: Iterable[int],
    ranges: Ranges | None = None,
    compared: Container[int] = (),
) -> Iterator[Seen]:
    """Yield what is seen of each seed.

    Args:
        protocol: How to look.
        stage: The environment.
        seeds: The seeds.
        ranges: Receives the observations of `compared`.
        compared: Some of the seeds.
    """
    tape, waiting, probes = Tape(), list[Seen](), len(protocol.actions) or 1

    def finished() -> Iterator[Seen]:
        found = tape.seeds(probes)
        arrays = []
        for seen in waiting:
            if seen.error:
                yield seen
                continue
            (first, *others), everything, alike = next(found)
            if seen.seed in compared:
                arrays.append(alike)
            steady = others.count(first) == len(others)
            yield Seen(seen.seed, digest(first), digest(everything), seen.state, steady)
        if ranges is not None:
            ranges.add(arrays)

    for seed in seeds:
        state = 0
        try:
            for probe, (env, first, actions) in enumerate(protocol.walk(stage, seed)):
                tape.begin(first)
                if not probe and protocol.state is not None:
                    state = digest(encode(called(protocol.state, env)))
                tape.play(env.step, actions)
            waiting.append(Seen(seed, state=state))
        except EnvironmentFailure as error:
            stage.close()
            tape.cut(probes * sum(not seen.error for seen in waiting))
            waiting.append(Seen(seed, error=str(error)))
        if tape.size > TAPE_BYTES:
            yield from finished()
            tape, waiting = Tape(), []
    yield from finished()


def action_sequences(env: Any, probes: int, steps: int, draw: Draw | None) -> Any:
    """Return random action sequences with a fixed seed, or None if actions cannot be drawn.

    Args:
        env: An environment; its action space is sampled if `draw` is None.
        probes: The number of sequences.
        steps: Their length.
        draw: Draws an action.
    """
    if draw is not None:
        rng = np.random.default_rng(ACTION_SEED)
        return tuple(tuple(draw(rng) for _ in range(steps)) for _ in range(probes))
    space: Any = copy.deepcopy(getattr(env, "action_space", None))
    if not hasattr(space, "sample"):
        return None
    space.seed(ACTION_SEED)
    return tuple(tuple(space.sample() for _ in range(steps)) for _ in range(probes))

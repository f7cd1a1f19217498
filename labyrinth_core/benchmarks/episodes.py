"""What is seen of a seed: its first observation, and episodes of fixed actions."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from labyrinth_core.benchmarks.encoding import digest, encode
from labyrinth_core.benchmarks.errors import (
    FAILURES,
    CertifyError,
    EnvironmentFailure,
    called,
    failure,
)
from labyrinth_core.benchmarks.making import Maker, StateOf, close, known_state
from labyrinth_core.benchmarks.spread import Ranges
from labyrinth_core.benchmarks.tape import Tape

Draw = Callable[[np.random.Generator], Any]
"""Returns a random action of an environment without an action space that can be sampled."""

ACTION_SEED = 0
"""The seed of the action sequences."""
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

    def walk(self, stage: Stage, seed: int) -> Iterator[tuple[int, int, Any]]:
        """Yield the probe, the step and what is seen there, for all probes of a seed.

        At step 0 that is the first observation; after it the observation, the reward, and whether
        the episode was terminated or truncated. An environment may overwrite what it returned when
        the iteration goes on.

        Raises:
            CertifyError: The environment cannot be made, or is not one of Gymnasium.
            EnvironmentFailure: The environment fails at this seed.
        """
        for probe, actions in enumerate(self.actions or ((),)):
            env = stage.ready()
            result = called(env.reset, seed=seed)
            if not (isinstance(result, tuple) and len(result) == 2):
                raise CertifyError(
                    f"{self.maker.name}: reset(seed=...) returns {type(result).__name__}, not "
                    "(observation, info): record it with examples/record_levels.py instead"
                )
            yield probe, 0, result[0]
            for step, action in enumerate(actions, 1):
                try:  # Not `called`, whose own time is a part of a quick step.
                    seen, ended = stepped(
                        env, action if isinstance(action, IMMUTABLE) else copy.copy(action)
                    )
                except FAILURES as error:
                    raise failure(error) from error
                yield probe, step, seen
                if ended:
                    break


def stepped(env: Any, action: Any) -> tuple[tuple[Any, Any, Any, Any], bool]:
    """Take a step; return what `Protocol.walk` yields of it, and whether the episode has ended."""
    observation, reward, terminated, truncated, _ = env.step(action)
    return (observation, reward, terminated, truncated), bool(terminated or truncated)


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


def look(protocol: Protocol, stage: Stage, seed: int, ranges: Ranges | None = None) -> Seen:
    """Return what is seen of a seed.

    Args:
        protocol: How to look.
        stage: The environment.
        seed: The seed.
        ranges: Receives the observations.
    """
    tape, state = Tape(), b""
    try:
        for probe, step, seen in protocol.walk(stage, seed):
            if step:
                tape.step(seen)
                continue
            tape.begin(seen)
            if not probe and protocol.state is not None:
                state = encode(called(protocol.state, stage.env))
    except EnvironmentFailure as error:
        stage.close()
        return Seen(seed, error=str(error))
    observations = tape.end()
    if ranges is not None:
        ranges.add(observations)
    first, *others = tape.first()
    steady = all(other == first for other in others)
    return Seen(seed, digest(first), digest(tape.all()), digest(state), steady)


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


def state_function(env: Any, state: StateOf | None) -> tuple[str, StateOf] | None:
    """Return the state function to use and its name; None if there is none."""
    name = getattr(state, "__qualname__", type(state).__name__)
    return known_state(env) if state is None else (name, state)

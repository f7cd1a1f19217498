"""What an agent solves that remembers the demonstrations of train, and looks only once."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.benchmarks.encoding import encode
from labyrinth_core.benchmarks.environment import CertifyError, EnvironmentFailure, called
from labyrinth_core.benchmarks.episodes import Draw, Protocol, Stage, steps_of
from labyrinth_core.benchmarks.levels import Share

Policy = Callable[[Any], Any]
"""Observation -> action."""

MOST_SEEDS = 1_000
"""The maximum number of seeds of train that are remembered, and of test that are played."""
LONGEST = 1_000
"""The maximum length of an episode, in steps."""


@dataclass(frozen=True)
class Memory:
    """How many seeds of test are solved: by memory, by the policy, by random actions.

    Memory replays, without looking again, the demonstration of the train seed with the same first
    observation; if there is none, of the train seed with the nearest (least Manhattan distance).
    """

    train: int
    """The number of demonstrations."""
    known: Share
    """Seeds of test whose first observation is one of the demonstrations'."""
    memory: Share
    policy: Share | None
    """None if demonstrations were given, and no policy."""
    random: Share
    solved_above: float
    """An episode is solved if its return is above this."""


class Played(NamedTuple):
    """One episode: its first observation, what was done, and the return."""

    first: bytes
    vector: NDArray[np.float32]
    """The numbers of the first observation, shape (numbers,)."""
    actions: tuple[Any, ...]
    total: float


Act = Callable[[int, Any], Any]
"""Step and observation -> action, or None to end the episode."""


def measure_memory(
    protocol: Protocol,
    train: Sequence[int],
    test: Sequence[int],
    policy: Policy | None,
    demonstrations: Mapping[int, Sequence[Any]] | None,
    draw: Draw,
    solved_above: float,
    mapped: Callable[[Callable[[int], Any], Sequence[int], str], Iterable[Any]],
) -> Memory:
    """Return what memory solves of test.

    Args:
        protocol: Makes the environment.
        train: The seeds of train; the first `MOST_SEEDS` that have a demonstration are used.
        test: The seeds of test; the first `MOST_SEEDS` are used.
        policy: Makes the demonstrations, unless they are given.
        demonstrations: Seed of train -> its actions.
        draw: Draws a random action.
        solved_above: An episode with a larger return is solved.
        mapped: Applies a function to seeds, in processes.

    Raises:
        CertifyError: No seed of train has a demonstration, or the environment or policy fails.
    """
    if demonstrations is not None:
        train = [seed for seed in train if seed in demonstrations]
    train, test = train[:MOST_SEEDS], test[:MOST_SEEDS]
    if not train:
        raise CertifyError("demonstrations: no seed of train has one")
    routes = demonstrations and {seed: tuple(demonstrations[seed]) for seed in train}
    teacher = partial(_play, protocol, policy=policy, routes=routes)
    shown: list[Played] = list(mapped(teacher, train, "demonstrations"))
    first = list(mapped(partial(_play, protocol, routes={}), test, "first observations"))
    chosen = dict(zip(test, _recalled(shown, first), strict=True))
    remembered = {seed: shown[index].actions for seed, index in chosen.items()}
    replay = partial(_play, protocol, routes=remembered)
    known = {episode.first for episode in shown}

    def share(player: Callable[[int], Played], label: str) -> Share:
        totals = [played.total for played in mapped(player, test, label)]
        return Share(sum(total > solved_above for total in totals), len(test))

    return Memory(
        train=len(train),
        known=Share(sum(episode.first in known for episode in first), len(test)),
        memory=share(replay, "memory"),
        policy=None if policy is None else share(partial(_play, protocol, policy=policy), "policy"),
        random=share(partial(_play, protocol, draw=draw), "random"),
        solved_above=solved_above,
    )


def _play(
    protocol: Protocol,
    seed: int,
    policy: Policy | None = None,
    routes: Mapping[int, Sequence[Any]] | None = None,
    draw: Draw | None = None,
) -> Played:
    """Play one episode in a new environment: of a route if there are any, else of the policy."""
    route = None if routes is None else routes.get(seed, ())
    rng = np.random.default_rng(seed)
    taken: list[Any] = []
    total = 0.0
    stage = Stage(protocol)

    def actions() -> Iterator[Any]:
        for step in range(LONGEST if route is None else len(route)):
            if route is not None:
                action = route[step]
            elif draw is not None:
                action = draw(rng)
            elif policy is not None:
                action = policy(observation)
            taken.append(copy.deepcopy(action))
            yield action

    try:
        env = stage.ready()
        observation = called(lambda: env.reset(seed=seed)[0])
        first, vector = encode(observation), _numbers(observation)
        for observation, reward, *_ in steps_of(env, actions()):  # noqa: B007  `actions` reads it.
            total += called(float, reward)
    except EnvironmentFailure as error:
        raise CertifyError(f"seed {seed}: the environment or the policy fails: {error}") from error
    finally:
        stage.close()
    return Played(first, vector, tuple(taken), total)


def _recalled(shown: Sequence[Played], first: Iterable[Played]) -> Iterator[int]:
    """Yield, for each first observation, the index of the demonstration to replay."""
    same: dict[bytes, int] = {}
    for index, episode in enumerate(shown):
        same.setdefault(episode.first, index)
    by_size: dict[int, list[int]] = {}
    for index, episode in enumerate(shown):
        by_size.setdefault(episode.vector.size, []).append(index)
    tables = {
        size: np.stack([shown[index].vector for index in places])
        for size, places in by_size.items()
    }
    for episode in first:
        size = episode.vector.size
        if episode.first in same or not size or size not in tables:
            yield same.get(episode.first, 0)
        else:
            apart = np.abs(tables[size] - episode.vector).sum(axis=1)
            yield by_size[size][int(apart.argmin())]


def _numbers(value: Any) -> NDArray[np.float32]:
    """Return the numbers in an observation, of dictionaries in the order of their keys."""
    if isinstance(value, Mapping):
        parts = [_numbers(value[key]) for key in sorted(value, key=encode)]
    elif isinstance(value, tuple | list):
        parts = [_numbers(item) for item in value]
    else:
        array = np.asarray(value)
        numeric = array.dtype.kind in "biuf"
        parts = [array.ravel().astype(np.float32)] if numeric else []
    return np.concatenate([np.zeros(0, np.float32), *parts])

"""The environment to certify: making and calling it, its seeds, its versions and its state."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from importlib.metadata import PackageNotFoundError, packages_distributions, version
from operator import index
from typing import Any

import numpy as np

from labyrinth_core.errors import one_line

StateOf = Callable[[Any], Any]
"""Environment -> everything that determines how its episode goes on, as `encode` takes it."""

REGISTERED_BY = (("MiniGrid-", "minigrid"), ("BabyAI-", "minigrid"), ("ALE/", "ale_py"))
"""How ids begin, and the package to import, which registers them."""

Seeds = range | Sequence[int] | str
"""Seeds as a caller gives them."""

MOST = 10_000_000
"""The maximum number of seeds of a split."""

FAILURES = (Exception, SystemExit)
"""What the code of others may raise, which is not a failure of ours."""


class CertifyError(ValueError):
    """A benchmark cannot be certified as asked; the message is one line that says why."""


class EnvironmentFailure(Exception):  # noqa: N818  An error of the environment, not of ours.
    """An environment raised an error or returned what it may not; the message is one line."""


def called(function: Callable[..., Any], *arguments: Any, **named: Any) -> Any:
    """Call code of others and return its result.

    Raises:
        EnvironmentFailure: The call raised an error, which is the cause, or ended the program.
    """
    try:
        return function(*arguments, **named)
    except (CertifyError, EnvironmentFailure):
        raise
    except FAILURES as error:
        raise failure(error) from error


def failure(error: BaseException) -> EnvironmentFailure:
    """Return an error of an environment as its failure."""
    return EnvironmentFailure(f"{type(error).__name__}: {one_line(error):.200}")


@dataclass(frozen=True)
class Maker:
    """Makes an environment as often as one is needed, in any process."""

    name: str
    """The id of the environment, or the name of the function that makes it."""
    source: Any
    """A specification of Gymnasium, or the function."""

    @classmethod
    def of(cls, environment: object) -> Maker:
        """Return the maker of an environment.

        Args:
            environment: An id of Gymnasium, such as `module:Name-v0`; or a function without
                arguments that makes the environment.

        Raises:
            CertifyError: It is neither, or Gymnasium does not know the id.
        """
        if callable(environment):
            module, name = (
                getattr(environment, each, "") for each in ("__module__", "__qualname__")
            )
            return cls(f"{module}:{name}" if name else type(environment).__name__, environment)
        if not isinstance(environment, str):
            raise CertifyError(
                f"environment={environment!s:.60}: give an id of Gymnasium, a function without "
                "arguments that makes the environment, or a file of records"
            )
        import gymnasium

        module, _, name = environment.rpartition(":")
        if not module:
            module = next((of for start, of in REGISTERED_BY if name.startswith(start)), "")
        try:
            if module:
                import_module(module)
            return cls(environment, gymnasium.spec(name))
        except (gymnasium.error.Error, ImportError, TypeError, ValueError) as error:
            hint = "" if module else "; if its package is not imported, give module:ID"
            raise CertifyError(f"{environment}: {one_line(error)}{hint}") from error

    def make(self) -> Any:
        """Return a new environment.

        Raises:
            CertifyError: It cannot be made.
        """
        try:
            if callable(self.source):
                return self.source()
            import gymnasium

            return gymnasium.make(self.source, disable_env_checker=True)
        except FAILURES as error:
            kind = type(error).__name__
            raise CertifyError(f"{self.name} cannot be made: {kind}: {one_line(error)}") from error


def close(env: Any) -> None:
    """Close an environment, of which nothing is read any more."""
    with contextlib.suppress(*FAILURES):
        getattr(env, "close", lambda: None)()


def unwrapped(env: Any) -> Any:
    """Return an environment without its wrappers."""
    return getattr(env, "unwrapped", env)


@cache
def _owners() -> Mapping[str, list[str]]:
    """Return the names of the packages that have each module; to find them takes 0.25 s."""
    return packages_distributions()


def versions_of(env: Any) -> dict[str, str]:
    """Return the versions of the packages that define an environment and its interface."""
    modules = {type(unwrapped(env)).__module__.partition(".")[0], "gymnasium", "numpy"}
    owners = _owners()
    names = {owner for module in modules for owner in owners.get(module, ())}
    found = {}
    for name in sorted({*names, "labyrinth-datasets"}):
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return found


def state_function(env: Any, state: StateOf | None) -> tuple[str, StateOf] | None:
    """Return the state function to use and its name: the one given or known; None without it."""
    if state is not None:
        return getattr(state, "__qualname__", type(state).__name__), state
    bases = {f"{base.__module__}:{base.__qualname__}" for base in type(unwrapped(env)).__mro__}
    if "minigrid.minigrid_env:MiniGridEnv" in bases:
        return "minigrid", _minigrid
    if "labyrinth_core.env.environment:LabyrinthEnv" in bases:
        return "labyrinth", _labyrinth
    return None


def _minigrid(env: Any) -> Any:
    """Return the state of MiniGrid, and what `MiniGridEnv.hash()` leaves out.

    That is the mission, the object carried, the contents of boxes and the steps taken and allowed.
    The state of the random generator is not part of it.
    """
    env = unwrapped(env)

    def described(thing: Any) -> Any:
        if thing is None:
            return None
        return *thing.encode(), described(getattr(thing, "contains", None))

    inside = [described(thing) for thing in env.grid.grid if getattr(thing, "contains", None)]
    return (
        env.grid.encode(),
        tuple(env.agent_pos),
        env.agent_dir,
        described(env.carrying),
        inside,
        env.mission,
        (env.step_count, env.max_steps),
    )


def _labyrinth(env: Any) -> Any:
    from labyrinth_core.language import dump

    env = unwrapped(env)
    return dump(env.labyrinth), env.state


def seeds_of(given: object, name: str) -> tuple[int, ...]:
    """Return the seeds of a split, each once, in the order given.

    Args:
        given: A range, an iterable of whole numbers, or a text such as `0:1000,5000,0:10:2`.
        name: The name of the argument, for the message.

    Raises:
        CertifyError: The seeds are not whole numbers from 0 on, or there are none or too many.
    """
    allowed = "give seeds as a range, a list of whole numbers from 0 on, or a text such as 0:1000"
    refusal = CertifyError(f"{name}={given!s:.60}: {allowed}")
    try:
        if isinstance(given, str):
            parts: list[Sequence[int]] = [_part(part) for part in given.split(",")]
        elif isinstance(given, Iterable):
            parts = [given] if isinstance(given, range) else [[index(each) for each in given]]
        else:
            raise refusal
    except (TypeError, ValueError) as error:
        raise refusal from error
    count = sum(map(len, parts))
    if not 0 < count <= MOST:
        raise CertifyError(f"{name}={given!s:.60}: {count:,} seeds: give 1 to {MOST:,}")
    distinct = tuple(dict.fromkeys(seed for part in parts for seed in part))
    if min(distinct) < 0:
        raise refusal
    return distinct


def _part(text: str) -> range:
    numbers = re.fullmatch(r"\s*(\d+)(?::(\d+)(?::(\d+))?)?\s*", text, re.ASCII)
    if numbers is None:
        raise ValueError(text)
    first, end, step = numbers.groups()
    return range(int(first), int(first) + 1 if end is None else int(end), int(step or 1))


def evenly(seeds: Sequence[int], most: int) -> list[int]:
    """Return all seeds, or so many evenly chosen ones."""
    places = np.linspace(0, len(seeds) - 1, min(len(seeds), most)).astype(int)
    return [seeds[index] for index in places.tolist()]


def text_of(seeds: Sequence[int]) -> str:
    """Return seeds as the shortest text of single seeds and runs with step 1."""
    runs: list[list[int]] = []
    for seed in seeds:
        if runs and seed == runs[-1][1]:
            runs[-1][1] += 1
        else:
            runs.append([seed, seed + 1])
    return ",".join(f"{a}" if b == a + 1 else f"{a}:{b}" for a, b in runs)

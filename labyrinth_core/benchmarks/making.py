"""Making the environment to certify, and what is known of it: its name, versions and state."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from importlib.metadata import PackageNotFoundError, packages_distributions, version
from typing import Any

from labyrinth_core.benchmarks.errors import FAILURES, CertifyError
from labyrinth_core.errors import one_line

StateOf = Callable[[Any], Any]
"""Environment -> everything that determines how its episode goes on, as `encode` takes it."""

REGISTERED_BY = (("MiniGrid-", "minigrid"), ("BabyAI-", "minigrid"), ("ALE/", "ale_py"))
"""How ids begin, and the package to import, which registers them."""


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

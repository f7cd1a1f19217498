"""Policies by name: `module:name` in Python, or what the Hub holds."""

from __future__ import annotations

import inspect
import sys
from importlib import import_module
from pathlib import Path
from typing import Any

from labyrinth_core.evaluation.answers import PolicyError, asked
from labyrinth_core.policies.load import load_policy
from pipeline.config.errors import ConfigError, listed


def named_policy(name: str) -> Any:
    """Return the policy that a name stands for.

    Args:
        name: `module:name`, a policy in a module of the working directory or an installed one, or
            a class or a function without arguments that makes one; or an id on the Hub, such as
            `user/planner-5x5` or `user/planner-5x5@1.0.0`.

    Raises:
        ConfigError: There is no such module or name.
        DatasetError: The policy on the Hub cannot be read.
        PolicyError: The module, the class or the function raises an error.
    """
    if ":" not in name:
        source, _, revision = name.partition("@")
        return load_policy(source, revision=revision or None)
    module, _, attribute = name.partition(":")
    here = str(Path.cwd())
    if here not in sys.path:  # As for `python -m`; the installed command has its own folder there.
        sys.path.insert(0, here)
    found: Any = _imported(name, module)
    for part in attribute.split("."):
        if not hasattr(found, part):
            known = [each for each in vars(found) if not each.startswith("_")]
            raise ConfigError(f"policy={name}: there is no {part}, only {listed(known)}")
        found = getattr(found, part)
    return asked(found) if _makes_one(found) else found


def _imported(name: str, module: str) -> Any:
    try:
        return asked(import_module, module)
    except PolicyError as error:
        cause = error.__cause__
        if isinstance(cause, ModuleNotFoundError) and f"{module}.".startswith(f"{cause.name}."):
            here = Path.cwd()
            told = (
                f"policy={name}: there is no module {cause.name}, neither in {here} nor installed"
            )
            raise ConfigError(told) from error
        raise


def _makes_one(found: Any) -> bool:
    """Return whether something is not a policy itself, but called without arguments makes one."""
    if inspect.isclass(found):
        return True
    if not inspect.isroutine(found):
        return False
    parameters = inspect.signature(found).parameters.values()
    variable = (inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD)
    return not any(each.default is each.empty and each.kind not in variable for each in parameters)

"""Find a method of learning by its name, with its settings.

A built-in method is a module of `labyrinth_core.learning.methods` with two classes, `Settings` and
`Method`. A user's own method, `method=custom method._target_=module.Class`, has `Settings` in the
same module (docs/new-method.md).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import MISSING, fields
from importlib import import_module
from inspect import isabstract, isclass
from typing import Any

from labyrinth_core.learning import BaseSettings, Learner
from pipeline.config import TrainingOptions, check, check_options, frozen


def find(
    name: str, values: Mapping[str, Any], protocol: str = "default"
) -> tuple[type[Learner], BaseSettings]:
    """Return a method and its settings.

    Args:
        name: The name of a method, such as `bc`, or `module:Class` for a user's method.
        values: Values of settings; the other settings have their defaults.
        protocol: One of `PROTOCOLS`.

    Raises:
        ConfigError: The method or a setting does not exist, or a value is not allowed.
    """
    if ":" in name:
        method, settings = _of_user(name)
    else:
        ours = TrainingOptions.METHODS
        check(name in ours, f"method={name}: choose one of [{', '.join(ours)}]")
        module = import_module(f"labyrinth_core.learning.methods.{name}")
        method, settings = module.Method, module.Settings
    allowed = [method.protocol] if method.protocol else ["default", "paper"]
    supported = f"method={name} supports only {' or '.join(allowed)}"
    check(protocol in allowed, f"protocol={protocol}: {supported}")
    chosen_values = {key: value for key, value in values.items() if key != "name"}
    for each in fields(settings):
        has_value = each.name in chosen_values or each.default is not MISSING
        check(has_value, f"method.{each.name} is missing: give it a value")
    chosen = frozen(settings, chosen_values, "method.")
    check_options(chosen, settings, "method.")
    return method, chosen


def _of_user(name: str) -> tuple[type[Learner], type[BaseSettings]]:
    """Return a user's class `module:Class`, and its settings.

    A module that imports the class from another one may have `Settings` of its own for it.

    Raises:
        ConfigError: The class does not exist, is not a method, or has the name of a built-in one.
    """
    options = TrainingOptions(method={"name": name})
    method, title = options.users_method(), options.method_title
    check(
        isclass(method) and issubclass(method, Learner) and not isabstract(method),
        f"method={name}: give a class that inherits from labyrinth_core.learning.Learner and "
        "has a method epoch",
    )
    named = import_module(name.partition(":")[0])
    settings = getattr(named, "Settings", None) or method.settings_class()
    check(
        isclass(settings)
        and issubclass(settings, BaseSettings)
        and "__dataclass_fields__" in vars(settings),
        f"method={name}: its Settings class has to be a dataclass that inherits from BaseSettings",
    )
    check(
        method.protocol is not None or title.lower() not in TrainingOptions.METHODS,
        f"method={name}: {title} is the name of another method; rename the class or the module",
    )
    return method, settings

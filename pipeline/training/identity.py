"""What determines a run: its method and settings, its network, its device, and its description.

A built-in method is a module of `labyrinth_core.learning.methods` with two classes, `Settings` and
`Method`. A user's own method, `method=custom method._target_=module.Class`, has `Settings` in the
same module (docs/new-method.md).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import MISSING, fields
from importlib import import_module
from inspect import isabstract, isclass
from pathlib import Path
from typing import Any

import torch

from labyrinth_core.errors import DatasetError
from labyrinth_core.learning import BaseSettings, Learner, NetworkSpec
from labyrinth_core.storage import File
from pipeline.config import ConfigError, Job, TrainingOptions, check, check_options, frozen
from pipeline.machinery import Sums


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


def identify(
    job: Job[TrainingOptions], settings: Mapping[str, Any], fingerprint: str
) -> dict[str, Any]:
    """Return everything that determines the weights of a job, in plain types.

    Of a user's method it has the hash of its module, but not of what that imports.
    """
    options = job.options
    module, of_user, _ = options.method_name.partition(":")
    own = getattr(import_module(module), "__file__", None) if of_user else None
    code = {} if own is None else {"code": f"{Path(own).name} {File(Path(own)).sha256():.12}"}
    return {
        "method": options.method_name,
        "encoder": options.network,
        "observation": options.observation,
        "protocol": options.protocol,
        "train_labyrinths": options.train_labyrinths,
        "seed": job.dataset.seed,
        "settings": dict(settings),
        "config": job.dataset.name,
        "dataset": job.source,
        "revision": options.revision,
        "fingerprint": fingerprint,
        **code,
    }


def spec_of(job: Job[TrainingOptions]) -> NetworkSpec:
    """Return the specification of the network of a run's policy."""
    dataset = job.dataset
    return NetworkSpec(job.options.network, dataset.height, dataset.width, str(dataset.task))


def require_same(
    thing: str, actual: Mapping[str, Any], required: Mapping[str, Any], advice: str = ""
) -> None:
    """Raise a DatasetError that lists how `actual` differs from `required`, if it does."""
    if differing := Sums.differences(options_of(actual), options_of(required)):
        raise DatasetError(f"{thing} with {differing}{advice}")


def without_place(identity: Mapping[str, Any]) -> dict[str, Any]:
    """Return what determines a run's weights, which does not depend on where its dataset lies.

    The fingerprint of the dataset says which it is.
    """
    return {name: value for name, value in identity.items() if name not in ("dataset", "revision")}


def options_of(description: Mapping[str, Any]) -> dict[str, Any]:
    """Return a run's description with each setting under the name of its option, `method.NAME`."""
    options = {name: value for name, value in description.items() if name != "settings"}
    settings = description.get("settings", {})
    return options | {f"method.{name}": value for name, value in settings.items()}


def choose_device(options: TrainingOptions) -> torch.device:
    """Set the number of threads, and return the device to compute on.

    Raises:
        ConfigError: The device does not exist.
    """
    if options.threads is not None:
        torch.set_num_threads(options.threads)
    available = torch.accelerator.is_available()
    accelerator = torch.accelerator.current_accelerator() if available else None
    if options.device == "cuda" and (accelerator is None or accelerator.type != "cuda"):
        raise ConfigError("device=cuda: no such device is available; choose cpu or auto")
    return torch.device("cpu") if accelerator is None or options.device == "cpu" else accelerator

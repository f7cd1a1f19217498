"""The method that a configuration chooses: a file of the group `method`, or a class of the user.

`_target_` is the dotted name of a class, as `hydra.utils.get_class` reads it. Records and tables
call a method `bc` if it is one of ours, and `mine:Method` if it is the class `mine.Method`.
"""

from __future__ import annotations

import re
from collections.abc import Container, Mapping
from functools import cache
from pathlib import Path
from typing import Any

import yaml

from pipeline.config.errors import check, no_option
from pipeline.config.training import METHODS, TrainingOptions

_INSTALLED = Path(__file__).parents[1] / "conf"
CONF = (_INSTALLED if _INSTALLED.is_dir() else Path(__file__).parents[2] / "conf").absolute()
"""Hydra's configuration folder: in the installed package, or else in the clone."""


@cache
def usual_settings(name: str) -> Mapping[str, Any]:
    """Return the settings of a method in its file of the group `method`, with their values."""
    text = (CONF / "method" / f"{name}.yaml").read_text(encoding="utf-8")
    return {key: value for key, value in yaml.safe_load(text).items() if key != "_target_"}


def chosen_method(values: Mapping[str, Any], typed: Container[str]) -> dict[str, Any]:
    """Return the name of a method in records, and the settings that were chosen for it.

    A setting is chosen if the command line gives it, or has another value than in the method's own
    file; those of a user's method all are. The others are not compared with a run's when the run is
    evaluated.

    Args:
        values: `_target_` and the settings, as composed.
        typed: The names of the options that the command line gives, such as `method.epochs`.

    Raises:
        ConfigError: The class is missing or is not a dotted name, or a setting does not exist.
    """
    settings = {key: value for key, value in values.items() if key != "_target_"}
    target = str(values.get("_target_", ""))
    check(
        re.fullmatch(r"\w+(\.\w+)+", target) is not None,
        f"method._target_={target}: give the class of a method as module.Class",
    )
    name = TrainingOptions.name_of(target)
    if name in METHODS:
        usual = usual_settings(name)
        for key in settings:
            known = [f"method.{each}" for each in usual]
            check(key in usual, no_option(f"method.{key}", known))
        settings = {
            key: value
            for key, value in settings.items()
            if value != usual[key] or f"method.{key}" in typed
        }
    return {"name": name, **settings}

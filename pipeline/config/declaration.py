"""Options: each is declared once, as a field of a frozen dataclass.

The declaration gives the schema that Hydra merges values into, the text of `--help`,
docs/options.md and the checks.
"""

from __future__ import annotations

import difflib
import re
import shlex
from collections.abc import Iterable, Mapping
from dataclasses import field, fields, is_dataclass
from math import inf
from pathlib import Path
from typing import Any, TypeVar, cast, get_args, get_origin, get_type_hints

from labyrinth_core.checks import Checks

Options = TypeVar("Options")

_LOCAL_FOLDER = (r"(?s)(?!.*://).*\S.*", "a folder on this machine")
_DATASET = (r"(.*[^/]/\d+x\d+(-\w+)?/?)?", "a dataset and its config, such as data/other/4x6")
"""Patterns of values, and what they allow in words."""


_FORMER = {
    **dict.fromkeys(
        ("buckets.train", "buckets.validation", "buckets.test"),
        "give the three percents, as buckets=[34,33,33]",
    ),
    "executor_address": "give the address of the cluster, as executor=tcp://host:8786",
    "executor_wait": "a run waits for workers as long as it takes, so leave it out",
    **dict.fromkeys(
        ("leakage", "leakage.source", "leakage.config"),
        "give stages=certify certify.source=... certify.config=...",
    ),
}
"""Option of an earlier version, also in files that it kept -> what to do now."""


class ConfigError(ValueError):
    """An option has an invalid value; the message is one line that says what to give."""

    @classmethod
    def no_option(cls, name: str, known: Iterable[str]) -> ConfigError:
        """Return the error about an option that does not exist: its likely name, or all names.

        Args:
            name: The name that was given.
            known: The options that exist.
        """
        if name in _FORMER:
            return cls(f"{name} is no longer an option: {_FORMER[name]}")
        names = [*known]
        group = f"{name.rpartition('.')[0]}."
        # A common prefix would make any two names similar.
        within = group if all(each.startswith(group) for each in names) else ""
        close = [each for each in names if each.endswith(f".{name}")] or [
            within + each
            for each in difflib.get_close_matches(
                name.removeprefix(within), [each.removeprefix(within) for each in names], n=1
            )
        ]
        advice = f"did you mean {close[0]}?" if close else f"choose from {listed(names)}"
        return cls(f"{name} is not an option: {advice}")


def check(holds: bool, message: str) -> None:
    """Raise a ConfigError with the message unless the condition holds."""
    if not holds:
        raise ConfigError(message)


def listed(words: Iterable[object]) -> str:
    """Return words as `[a, b]` for a message."""
    return f"[{', '.join(map(str, words))}]"


def option(
    default: Any,
    meaning: str,
    *,
    at_least: float | None = None,
    at_most: float = inf,
    one_of: Iterable[object] = (),
    like: tuple[str, str] | None = None,
    is_local_folder: bool = False,
    is_dataset: bool = False,
) -> Any:
    """Return the field that declares an option.

    Args:
        default: The value if the user gives none; MISSING if the user must give one.
        meaning: A phrase for `--help`, in which a noun says what the value is.
        at_least: The minimum of a number; None leaves the number unchecked.
        at_most: The maximum of a number.
        one_of: The allowed values; of a number, those besides numbers. A tuple option takes several
            of them; it may be empty only if its default is.
        like: A regular expression for the whole text, and a phrase that says what to give.
        is_local_folder: Whether the value is a folder on this machine, and not a URL.
        is_dataset: Whether the value is a folder of datasets or an id on the Hub, with a config.
    """
    like = _LOCAL_FOLDER if is_local_folder else _DATASET if is_dataset else like
    metadata = {"meaning": meaning, "checks": Checks(at_least, at_most, [*one_of], like)}
    if isinstance(default, dict):
        return field(default_factory=default.copy, metadata=metadata)
    return field(default=default, metadata=metadata)


def frozen(cls: type[Options], values: Mapping[str, Any], group: str = "") -> Options:
    """Return an instance of a class of options, from a mapping of names to values.

    Raises:
        ConfigError: An option does not exist, or a value has the wrong type.
    """
    kinds = get_type_hints(cls)
    made = {}
    for name, value in values.items():
        if name not in kinds:
            raise ConfigError.no_option(group + name, (group + each for each in kinds))
        made[name] = _value(group + name, value, kinds[name])
    return cls(**made)


def _value(name: str, value: Any, kind: Any) -> Any:
    """Return a value in its option's declared type; raise a ConfigError if it does not fit.

    For a list of texts, a single text is accepted.
    """
    if is_dataclass(kind) or get_origin(kind) is dict:
        check(isinstance(value, dict), f"{name}={value}: give its own options, as {name}.NAME=...")
        return frozen(cast(type, kind), value, f"{name}.") if is_dataclass(kind) else value
    for key in value if isinstance(value, dict) else ():
        if f"{name}.{key}" in _FORMER:
            raise ConfigError.no_option(f"{name}.{key}", ())
    if get_origin(kind) is tuple:
        of = get_args(kind)[0]
        values = [value] if isinstance(value, str) and of is str else value
        fits = isinstance(values, list) and all(type(item) is of for item in values)
        what = "texts" if of is str else "whole numbers"
        check(fits, f"{name}={value}: give a list of {what}")
        return tuple(values)
    if kind is bool:
        check(str(value).lower() in ("true", "false"), f"{name}={value}: give true or false")
        return str(value).lower() == "true"
    check(not isinstance(value, list | dict), f"{name}={value}: give a single value")
    try:
        Path(value if isinstance(value, str) else "").expanduser()
    except RuntimeError as error:  # HOME is not set, or the user does not exist.
        message = f"{name}={value}: that user's home folder is unknown: give the full path"
        raise ConfigError(message) from error
    return value


def check_options(options: Any, cls: type, group: str = "") -> None:
    """Check the values of the options that a class declares, and those of its groups.

    A group whose field has `is_checked=False` in its metadata is left to the stage.

    Args:
        options: An instance of the class, or of one that inherits from it.
        cls: The class.
        group: The prefix of the names of the options.

    Raises:
        ConfigError: A value is invalid; the message says what was given and what is allowed.
    """
    kinds = get_type_hints(cls)
    for each in fields(cls):
        if is_dataclass(kinds[each.name]):
            if each.metadata.get("is_checked", True):
                group_type: Any = kinds[each.name]
                check_options(getattr(options, each.name), group_type, f"{each.name}.")
            continue
        if "checks" not in each.metadata:
            continue
        checks: Checks = each.metadata["checks"]
        low, one_of, like = checks.at_least, checks.one_of, checks.like
        name, value, kind = group + each.name, getattr(options, each.name), kinds[each.name]
        if kind is bool:
            check(isinstance(value, bool), f"{name}={value}: give true or false")
        elif isinstance(value, list | tuple):
            fits = set(value) <= set(one_of) and (len(value) > 0 or each.default == ())
            check(not one_of or fits, f"{name}={listed(value)}: choose from {listed(one_of)}")
        elif one_of and low is None:
            check(value in one_of, f"{name}={value}: choose one of {listed(one_of)}")
        elif like is not None:
            matches = re.fullmatch(like[0], value, re.ASCII) is not None
            check(matches, f"{name}={value}: give {like[1]}")
        elif low is not None and (value is not None or kind in (int, float)):
            number = type(value) is int or (kind is float and isinstance(value, float))
            what = "a number" if kind is float else "a whole number"
            high = checks.at_most
            limits = f", {low:,} or more" if high == inf else f" from {low:,} to {high:,}"
            others = f", or {', '.join(map(str, one_of))}" if one_of else ""
            check(
                value in one_of or (number and low <= value <= high and value != inf),
                f"{name}={value}: give {what}{limits}{others}",
            )


def literal(value: str) -> str:
    """Return a text with each `${` escaped, which OmegaConf would take for a reference."""
    return re.sub(r"(\\*)\$\{", r"\1\1\\${", value)


def _as_value(value: object) -> str:
    """Return the value of an option as Hydra's grammar reads it, in quotation marks if needed."""
    if value is None or isinstance(value, bool):
        return "null" if value is None else str(value).lower()
    if isinstance(value, list | tuple):
        return f"[{','.join(map(_as_value, value))}]"
    text = str(value)
    if not isinstance(value, str) or re.fullmatch(r"(?!null$)[\w./:@%+-]+", text, re.ASCII):
        return text
    text = literal(text)
    # Hydra reads a backslash as an escape only before a quotation mark, even the closing one.
    text = re.sub(r'(\\*)"', r'\1\1\\"', text)
    return f'"{text}{text[len(text.rstrip(chr(92))) :]}"'


def as_typed(name: str, value: object) -> str:
    """Return `name=value` as typed in a shell, with quotation marks for Hydra if needed."""
    return shlex.quote(f"{name}={_as_value(value)}")

"""Options: each is declared once, as a field of a frozen dataclass.

The schema that Hydra merges values into, the text of `--help`, the README's table and the checks
follow from the declaration.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import field, fields, is_dataclass
from math import inf
from pathlib import Path
from typing import Any, TypeVar, get_args, get_origin, get_type_hints

from pipeline.config.errors import ConfigError, check, listed
from pipeline.config.gone import instead

Options = TypeVar("Options")

_STRUCTURED = re.compile(r"""["'\\$()\[\]{}]""")
"""A character that has a meaning of its own in Hydra's grammar, apart from a comma."""

FOLDER = (r"(?s).*\S.*", "a folder")
LOCAL_FOLDER = (r"(?s)(?!.*://).*\S.*", "a folder on this machine")


def option(
    default: Any,
    meaning: str,
    *,
    at_least: float | None = None,
    at_most: float = inf,
    one_of: Iterable[object] = (),
    like: tuple[str, str] | None = None,
) -> Any:
    """Return the field that declares an option.

    Args:
        default: Its value where none is given; MISSING if one has to be given.
        meaning: A phrase for `--help`, in which a noun says what the value is.
        at_least: The least value of a number; None for an option whose number is not checked.
        at_most: The greatest value of a number.
        one_of: The values to choose from; one, or several if the option is a tuple.
        like: A regular expression for the whole text, and a phrase that says what to give.
    """
    metadata = {"meaning": meaning, "checks": (at_least, at_most, list(one_of), like)}
    if isinstance(default, dict):
        return field(default_factory=default.copy, metadata=metadata)
    return field(default=default, metadata=metadata)


def meanings(cls: type, group: str = "") -> dict[str, str]:
    """Return what the options that a class declares mean, by their names."""
    found = {}
    for each in fields(cls):
        if "meaning" in each.metadata:
            found[group + each.name] = each.metadata["meaning"]
        elif is_dataclass(each.default):
            found |= meanings(type(each.default), f"{group}{each.name}.")
    return found


def frozen(cls: type[Options], values: Mapping[str, Any], group: str = "") -> Options:
    """Return an instance of a class that declares options, from values by their names.

    Raises:
        ConfigError: A name is not that of an option, or a value is of another kind.
    """
    kinds = get_type_hints(cls)
    made = {}
    for name, value in values.items():
        allowed = f"{group}{name} is no option: choose from {listed(kinds)}"
        check(name in kinds, instead(group + name) or allowed)
        _check_kind(group + name, value, kinds[name])
        _check_home(group + name, value)
        made[name] = tuple(value) if isinstance(value, list) else value
        if is_dataclass(kinds[name]):
            made[name] = frozen(kinds[name], value, f"{group}{name}.")
    return cls(**made)


def _check_kind(name: str, value: Any, kind: Any) -> None:
    """Raise a ConfigError if a value is a list, or has options of its own, and should not."""
    if get_origin(kind) is tuple:
        allowed = "a list of texts"
        fits = isinstance(value, list | tuple) and all(isinstance(each, str) for each in value)
    elif is_dataclass(kind) or get_origin(kind) is dict:
        fits, allowed = isinstance(value, dict), f"its own options, as {name}.NAME=..."
    else:
        fits, allowed = not isinstance(value, list | tuple | dict), "a single value"
    check(fits, f"{name}={value}: give {allowed}")


def _check_home(name: str, value: Any) -> None:
    """Raise a ConfigError if a text is a path from a home folder that is unknown."""
    try:
        Path(value if isinstance(value, str) else "").expanduser()
    except RuntimeError as error:  # Without HOME, or of a user who does not exist.
        message = f"{name}={value}: the home folder of the user is unknown: give the whole path"
        raise ConfigError(message) from error


def as_declared(argument: str, cls: type) -> str:
    """Return an argument of a command line for Hydra, which does not know what an option is.

    A text is read as it is typed (`revision=1.10` is not 1.1), and a list may be one bare value.
    All else stays as it is.

    Args:
        argument: An argument such as `revision=1.10`; several values stand between commas.
        cls: The class that declares the options.

    Raises:
        ConfigError: A value is none of a switch, or not the name of one group of options.
    """
    name, equals, value = argument.partition("=")
    kind, parts = _kind_of(cls, name.lstrip("+")), value.split(",")
    if kind is None or not equals:
        return argument
    if get_origin(kind) is dict:
        check(value not in ("", "null") and value[:1] != "[", f"{argument}: give one name")
    if _STRUCTURED.search(value):
        return argument
    if kind is bool:
        given = {part.strip().lower() for part in parts}
        check(given <= {"true", "false"}, f"{argument}: give true or false")
    elif get_origin(kind) is tuple and value and len(parts) == 1:
        return f"{name}=[{value}]"
    elif str in (kind, *get_args(kind)) and get_origin(kind) is not tuple:
        kept = () if kind is str else ("null",)
        parts = [part if part in kept else _as_text(part) for part in parts]
    return f"{name}={','.join(parts)}"


def _kind_of(cls: type, name: str) -> Any:
    """Return the declared type of an option by its whole name, None if it is not declared."""
    group, _, rest = name.partition(".")
    kind = get_type_hints(cls).get(group)
    if rest:
        return _kind_of(kind, rest) if isinstance(kind, type) and is_dataclass(kind) else None
    return kind


def _as_text(value: str) -> str:
    """Return a value in quotation marks, unless Hydra reads the very text without them."""
    from hydra.core.override_parser.overrides_parser import OverridesParser
    from hydra.errors import HydraException

    try:
        read = str(OverridesParser.create().parse_override(f"x={value}").value())
    except HydraException:
        read = ""
    return value if read == value else f'"{value}"'


def check_options(options: Any, cls: type, group: str = "") -> None:
    """Check the values of the options that a class declares.

    Args:
        options: An instance of the class, or of one that inherits from it.
        cls: The class.
        group: What goes before the names of the options.

    Raises:
        ConfigError: A value is impossible; the text says what was given and what is allowed.
    """
    kinds = get_type_hints(cls)
    for each in fields(cls):
        if "checks" not in each.metadata:
            continue
        low, high, one_of, like = each.metadata["checks"]
        name, value, kind = group + each.name, getattr(options, each.name), kinds[each.name]
        if kind is bool:
            check(isinstance(value, bool), f"{name}={value}: give true or false")
        elif isinstance(value, list | tuple):
            known = not one_of or (len(value) > 0 and set(value) <= set(one_of))
            allowed = f"{name}={listed(value)}: choose from {listed(one_of)}"
            check(known, instead(name, *value) or allowed)
        elif one_of:
            allowed = f"{name}={value}: choose one of {listed(one_of)}"
            check(value in one_of, instead(name, value) or allowed)
        elif like is not None:
            matches = re.fullmatch(like[0], value, re.ASCII) is not None
            check(matches, f"{name}={value}: give {like[1]}")
        elif low is not None and (value is not None or kind in (int, float)):
            number = type(value) is int or (kind is float and isinstance(value, float))
            what = "a number" if kind is float else "a whole number"
            limits = f", {low:,} or more" if high == inf else f" from {low:,} to {high:,}"
            check(
                number and low <= value <= high and value != inf,
                f"{name}={value}: give {what}{limits}",
            )

"""Errors in options, each explained in one line."""

from __future__ import annotations

import difflib
import re
import shlex
from collections.abc import Iterable


class ConfigError(ValueError):
    """An option has an invalid value; the message is one line that says what to give."""


def check(holds: bool, message: str) -> None:
    """Raise a ConfigError with the message unless the condition holds."""
    if not holds:
        raise ConfigError(message)


def listed(words: Iterable[object]) -> str:
    """Return words as `[a, b]` for a message."""
    return f"[{', '.join(map(str, words))}]"


def no_option(name: str, known: Iterable[str]) -> str:
    """Return the message about an option that does not exist: its likely name, or all names.

    Args:
        name: The name that was given.
        known: The options that exist.
    """
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
    return f"{name} is not an option: {advice}"


def literal(value: str) -> str:
    """Return a text with each `${` escaped, which OmegaConf would take for a reference."""
    return re.sub(r"(\\*)\$\{", r"\1\1\\${", value)


def _quoted(value: str) -> str:
    """Return a text as Hydra's grammar reads it, in quotation marks if it needs them."""
    if re.fullmatch(r"(?!null$)[\w./:@%+-]+", value, re.ASCII):
        return value
    value = literal(value)
    # Hydra reads a backslash as an escape only before a quotation mark, even the closing one.
    value = re.sub(r'(\\*)"', r'\1\1\\"', value)
    return f'"{value}{value[len(value.rstrip(chr(92))) :]}"'


def _as_value(value: object) -> str:
    """Return the value of an option as Hydra's grammar reads it."""
    if value is None or isinstance(value, bool):
        return "null" if value is None else str(value).lower()
    if isinstance(value, list | tuple):
        return f"[{','.join(map(_as_value, value))}]"
    return _quoted(value) if isinstance(value, str) else str(value)


def as_typed(name: str, value: object) -> str:
    """Return `name=value` as typed in a shell, with quotation marks for Hydra if needed."""
    return shlex.quote(f"{name}={_as_value(value)}")

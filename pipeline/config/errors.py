"""Errors in options, each explained in one line."""

from __future__ import annotations

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


def as_typed(name: str, value: str) -> str:
    """Return `name=value` as typed in a shell, with quotation marks for Hydra if needed."""
    if not re.fullmatch(r"[\w./:@%+-]+", value, re.ASCII):
        # Hydra reads a backslash as an escape only before a quotation mark, even the closing one.
        value = re.sub(r'(\\*)"', r'\1\1\\"', value)
        value = f'"{value}{value[len(value.rstrip(chr(92))) :]}"'
    return shlex.quote(f"{name}={value}")

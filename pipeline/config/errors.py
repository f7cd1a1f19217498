"""Errors in options, each explained in one line."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterable


class ConfigError(ValueError):
    """A value of an option is impossible; the text is one line that says what to give."""


def check(holds: bool, message: str) -> None:
    """Raise a ConfigError with the message unless the condition holds."""
    if not holds:
        raise ConfigError(message)


def listed(words: Iterable[object]) -> str:
    """Return words as a list for a message."""
    return f"[{', '.join(map(str, words))}]"


def as_typed(name: str, value: str) -> str:
    """Return an option as it is typed in a shell, in quotation marks for Hydra where need be."""
    if not re.fullmatch(r"[\w./:@%+-]+", value, re.ASCII):
        # A backslash counts for Hydra before a quotation mark alone, also the closing one.
        value = re.sub(r'(\\*)"', r'\1\1\\"', value)
        value = f'"{value}{value[len(value.rstrip(chr(92))) :]}"'
    return shlex.quote(f"{name}={value}")

"""Errors in options, each explained in one line."""

from __future__ import annotations

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

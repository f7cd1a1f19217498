"""Mistakes in options, each told in one line."""

from __future__ import annotations

from collections.abc import Iterable


class ConfigError(ValueError):
    """A value of the configuration that cannot be; its text is one line for the person."""


def check(holds: bool, message: str) -> None:
    """Raise a ConfigError with the message unless the condition holds."""
    if not holds:
        raise ConfigError(message)


def listed(words: Iterable[object]) -> str:
    """Return words as a list for a person."""
    return f"[{', '.join(map(str, words))}]"

"""Mistakes in options, each told in one line."""

from __future__ import annotations

from collections.abc import Iterable


class ConfigError(ValueError):
    """A value of the configuration that cannot be; its text is one line for the person."""


def check(holds: bool, message: str) -> None:
    """Raise a ConfigError with the message unless the condition holds."""
    if not holds:
        raise ConfigError(message)


def check_choice(name: str, value: object, allowed: Iterable[object]) -> None:
    """Raise a ConfigError unless the value of an option is one of those allowed."""
    allowed = list(allowed)
    check(value in allowed, f"{name}={value}: choose one of {listed(allowed)}")


def check_choices(name: str, values: Iterable[object], allowed: Iterable[object]) -> None:
    """Raise a ConfigError unless there is a value, and all of them are of those allowed."""
    values, allowed = list(values), list(allowed)
    known = bool(values) and all(value in allowed for value in values)
    check(known, f"{name}={listed(values)}: choose from {listed(allowed)}")


def listed(words: Iterable[object]) -> str:
    """Return words as a list for a person."""
    return f"[{', '.join(map(str, words))}]"

"""What values are allowed: an integer that a caller passes, a declared option or setting."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from math import inf
from numbers import Integral
from operator import index


@dataclass(frozen=True)
class Checks:
    """What the declaration of an option or a setting allows."""

    at_least: float | None = None
    """The minimum of a number; None leaves the number unchecked."""
    at_most: float = inf
    one_of: Sequence[object] = ()
    """The allowed values; of a number, those besides numbers."""
    like: tuple[str, str] | None = None
    """A regular expression for the whole text, and a phrase that says what to give."""


def whole(
    name: str, value: object, least: float = -inf, most: float = inf, *, allowed: str = ""
) -> int:
    """Return an integer of Python or NumPy as a Python `int`, which cannot overflow.

    Args:
        name: The name of the argument, for the message.
        value: Its value.
        least: The smallest number allowed.
        most: The largest number allowed.
        allowed: What the message says is allowed, if these bounds do not say it all.

    Raises:
        ValueError: The value has another type, such as `bool`, or is out of bounds.
    """
    number = value if type(value) is int else None
    if number is None and isinstance(value, Integral) and not isinstance(value, bool):
        with suppress(TypeError):  # NumPy's `timedelta64` counts as Integral, but is no index.
            number = index(value)
    if number is not None and least <= number <= most:
        return number
    bounds = f" from {least} on" if most == inf else f" from {least} to {most}"
    allowed = allowed or f"a whole number{'' if least == -inf else bounds}"
    raise ValueError(f"{name}={value!r:.60}: give {allowed}")

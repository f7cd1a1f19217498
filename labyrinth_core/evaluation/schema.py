"""Shapes that JSON from a file must match, declared as values and checked in one place.

A shape is one of the classes below; a dict, for an object with at least these keys; a tuple, for a
list with one shape per item; None, for anything; or any other value, for exactly that value.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from labyrinth_core.language.source_text import printable_line

_MOST = 1e15
"""No number in our files is larger; JavaScript, on the report's page, holds it exactly."""


@dataclass(frozen=True)
class Number:
    """A finite number, not a boolean."""

    low: float = -_MOST
    high: float = _MOST
    whole: bool = False
    or_text: str | None = None
    """A text that is allowed in place of the number."""


@dataclass(frozen=True)
class Text:
    """A string that fully matches a regular expression."""

    like: str


@dataclass(frozen=True)
class Maybe:
    """Null, or a value that matches `of`."""

    of: Any


@dataclass(frozen=True)
class OneOf:
    """One of some values."""

    values: tuple[Any, ...]


@dataclass(frozen=True)
class Each:
    """A list whose items all match `of`."""

    of: Any
    most: int | None = None
    """The largest number of items; None for any."""


@dataclass(frozen=True)
class Exactly:
    """An object with exactly these keys."""

    of: Mapping[str, Any]
    """Key -> shape of its value."""


@dataclass(frozen=True)
class Named:
    """An object with any number of keys, which match `name`, and values, which match `of`."""

    name: Any
    of: Any


COUNT = Number(0, whole=True)
SHARE = Number(0, 1 + 1e-9)
"""A sum of many probabilities may be a little more than 1."""


def check_shape(value: Any, shape: Any, place: str = "it") -> None:
    """Check that a value from JSON has a shape.

    Raises:
        ValueError: It does not match; the message gives the place, the value and what is allowed.
    """
    if isinstance(shape, Maybe):
        if value is not None:
            check_shape(value, shape.of, place)
        return
    wanted = _unmet(value, shape)
    if wanted is not None:
        raise ValueError(f"{place} is {value!r:.60}, not {wanted}")
    if isinstance(shape, dict | Exactly):
        for name, of in (shape if isinstance(shape, dict) else shape.of).items():
            check_shape(value[name], of, f"{place}.{name}")
    elif isinstance(shape, tuple):
        for number, (item, of) in enumerate(zip(value, shape, strict=True)):
            check_shape(item, of, f"{place}[{number}]")
    elif isinstance(shape, Each):
        whole = isinstance(shape.of, Number | Text)  # These have no items of their own to check.
        for number, item in enumerate(value):
            if not whole or _unmet(item, shape.of) is not None:
                check_shape(item, shape.of, f"{place}[{number}]")
    elif isinstance(shape, Named):
        for name, item in value.items():
            check_shape(name, shape.name, f"a name in {place}")
            check_shape(item, shape.of, f"{place}.{printable_line(name):.100}")


def _unmet(value: Any, shape: Any) -> str | None:
    """Return what a value should be, without a look at its items; None if it matches."""
    if shape is None:
        return None
    if isinstance(shape, OneOf):
        allowed = [each for each in shape.values if type(each) is type(value)]
        return None if value in allowed else f"one of {', '.join(map(str, shape.values))}"
    if isinstance(shape, Number):
        number = type(value) is int or (type(value) is float and not shape.whole)
        kind = "a whole number" if shape.whole else "a number"
        limits = f" from {shape.low:g} to {shape.high:g}"
        if shape.or_text is not None and value == shape.or_text:
            return None
        return None if number and shape.low <= value <= shape.high else kind + limits
    if isinstance(shape, Text):
        matches = isinstance(value, str) and re.fullmatch(shape.like, value, re.ASCII)
        return None if matches else f"a text like {shape.like}"
    if isinstance(shape, dict):
        holds = isinstance(value, dict) and shape.keys() <= value.keys()
        return None if holds else f"an object with {', '.join(shape)}"
    if isinstance(shape, Exactly):
        holds = isinstance(value, dict) and shape.of.keys() == value.keys()
        return None if holds else f"an object with {', '.join(shape.of)}"
    if isinstance(shape, Named):
        return None if isinstance(value, dict) else "an object"
    if isinstance(shape, tuple):
        fits = isinstance(value, list) and len(value) == len(shape)
        return None if fits else f"a list of {len(shape)}"
    if isinstance(shape, Each):
        fits = isinstance(value, list) and (shape.most is None or len(value) <= shape.most)
        return None if fits else "a list" + (f" of {shape.most} at most" if shape.most else "")
    return None if type(value) is type(shape) and value == shape else repr(shape)

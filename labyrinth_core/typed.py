"""Read JSON strictly: `read_as` returns a value as the type that it should have, or says why not.

A type is a dataclass, for an object with exactly its fields; a TypedDict, for an object with at
least its keys; `Mapping`, `tuple`, `list`, `Literal` and unions of types; `bool`, `int`, `float`
or `str`, which `Annotated` limits by `Within` or `Like`; or `Any`.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import MISSING, dataclass, fields, is_dataclass
from functools import cache
from types import UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

import numpy as np

from labyrinth_core.errors import printable_line

MOST = 10**15
"""No number in our files is larger; JavaScript, on the report's page, holds it exactly."""

Reader = Callable[[Any], Any]


@dataclass(frozen=True)
class Within:
    """Limits a number."""

    low: float = -MOST
    high: float = MOST


@dataclass(frozen=True)
class Like:
    """Limits a text: all of it matches a regular expression."""

    pattern: str


MOST_EPISODES = 1_000
"""The largest number of episodes in each labyrinth."""

CONTROLS = 10, 10_000
"""The smallest and the largest number of control training sets of a receipt."""

MOST_SEED = 2**64 - 1
"""The largest seed, of a dataset and of a policy."""

Count = Annotated[int, Within(0)]
Positive = Annotated[int, Within(1)]
Share = Annotated[float, Within(0, 1 + 1e-9)]
"""A sum of many probabilities may be a little more than 1."""
Sha256 = Annotated[str, Like("[0-9a-f]{64}")]
Word = Annotated[str, Like(r"\w[\w.-]{0,99}")]


Version = Annotated[str, Like(".{1,100}")]
Address = Annotated[str, Like("(?s).{1,300}")]
"""A folder, a file, or an id on the Hub, with a revision or without."""
Commit = Annotated[str, Like("[0-9a-f]{40}")]
Learnt = Positive | Annotated[str, Like("fresh")] | None
"""The number of labyrinths learnt from: None for all, `fresh` for new ones in each epoch."""
Seed = Annotated[int, Within(0, MOST_SEED)]
LabyrinthId = Annotated[str, Like("[0-7][0-9a-f]{15}")]


_DAY = re.compile(r"\d{4}-\d\d-\d\d", re.ASCII)


def is_day(text: str) -> bool:
    """Return whether a text is a day such as 2026-11-30."""
    try:
        return _DAY.fullmatch(text) is not None and not np.isnat(np.datetime64(text))
    except ValueError:
        return False


class _UnfitError(ValueError):
    """A value is not of its type; `place` grows on the way out."""

    def __init__(self, problem: str) -> None:
        super().__init__(problem)
        self.place = ""


def read_as(kind: Any, value: Any, name: str = "it") -> Any:
    """Return a value from JSON as a type; objects become dataclasses or dictionaries.

    Args:
        kind: The type.
        value: The value, from `read_json`.
        name: What the value is, for errors.

    Raises:
        ValueError: It has another type; the message gives the place, the value and what is allowed.
    """
    try:
        return _reader(kind)(value)
    except _UnfitError as unfit:
        raise ValueError(f"{name}{unfit.place} {unfit}") from None


@cache
def _reader(kind: Any) -> Reader:
    kind, *rules = get_args(kind) if get_origin(kind) is Annotated else (kind,)
    origin, parts = get_origin(kind), get_args(kind)
    if kind is Any:
        return lambda value: value
    if kind in (bool, int, float):
        return _number(kind, *rules)
    if kind is str:
        return _text(*rules)
    if origin is Literal:
        return _one_of(parts)
    if origin in (Union, UnionType):
        return _any_of(parts)
    if origin in (tuple, list):
        return _items(origin, parts)
    return _entries(*parts) if origin is Mapping else _fields(kind)


def _unless(fits: Callable[[Any], bool], allowed: str) -> Reader:
    """Return a reader that returns a value if it fits."""

    def read(value: Any) -> Any:
        if fits(value):
            return value
        raise _UnfitError(f"is {value!r:.60}, not {allowed}")

    return read


def _number(kind: type, limits: Within | None = None) -> Reader:
    if kind is bool:
        return _unless(lambda value: type(value) is bool, "true or false")
    kinds = (int,) if kind is int else (int, float)
    allowed = "a whole number" if kind is int else "a number"
    if limits is not None:
        allowed += f" from {limits.low:g} to {limits.high:g}"
    low, high = (-MOST, MOST) if limits is None else (limits.low, limits.high)
    return _unless(lambda value: type(value) in kinds and low <= value <= high, allowed)


def _text(rule: Like | None = None) -> Reader:
    if rule is None:
        return _unless(lambda value: isinstance(value, str), "a text")
    matches = re.compile(rule.pattern, re.ASCII).fullmatch
    return _unless(
        lambda value: isinstance(value, str) and matches(value) is not None,
        f"a text like {rule.pattern}",
    )


def _one_of(values: tuple[Any, ...]) -> Reader:
    allowed = f"one of {', '.join(map(repr, values))}" if len(values) > 1 else repr(values[0])
    kinds = {*map(type, values)}
    return _unless(lambda value: type(value) in kinds and value in values, allowed)


def _any_of(kinds: tuple[Any, ...]) -> Reader:
    readers = [_reader(kind) for kind in kinds if kind is not type(None)]

    def read(value: Any) -> Any:
        if value is None and type(None) in kinds:
            return None
        for reader in readers[1:]:
            try:
                return reader(value)
            except _UnfitError:
                continue
        return readers[0](value)

    return read


def _items(kind: type, parts: tuple[Any, ...]) -> Reader:
    """Return a reader of a list, with one type for all items or one for each."""
    alike = kind is list or parts[1:] == (...,)
    readers = [_reader(part) for part in (parts[:1] if alike else parts)]

    def read(value: Any) -> Any:
        if not isinstance(value, list) or not (alike or len(value) == len(readers)):
            number = "" if alike else f" of {len(readers)}"
            raise _UnfitError(f"is {value!r:.60}, not a list{number}")
        of = readers * len(value) if alike else readers
        try:
            return kind(each(item) for each, item in zip(of, value, strict=True))
        except _UnfitError:  # Read again, which names the place.
            return [_at(f"[{number}]", of[number], item) for number, item in enumerate(value)]

    return read


def _entries(name: Any, of: Any) -> Reader:
    """Return a reader of an object with any number of names."""
    name_of, value_of = _reader(name), _reader(of)

    def read(value: Any) -> dict[str, Any]:
        if not isinstance(value, dict):
            raise _UnfitError(f"is {value!r:.60}, not an object")
        for key in value:
            try:
                name_of(key)
            except _UnfitError as unfit:
                raise _UnfitError(f"has a name that {unfit}") from None
        return {key: _at(f".{printable_line(key):.100}", value_of, value[key]) for key in value}

    return read


def _fields(kind: Any) -> Reader:
    """Return a reader of an object with certain names: a dataclass or a TypedDict."""
    closed, hints = is_dataclass(kind), get_type_hints(kind, include_extras=True)
    names = [own_field.name for own_field in fields(kind)] if closed else hints
    readers = {name: _reader(hints[name]) for name in names}
    optional = {
        own_field.name
        for own_field in (fields(kind) if closed else ())
        if (own_field.default, own_field.default_factory) != (MISSING, MISSING)
    }

    def read(value: Any) -> Any:
        if not isinstance(value, dict):
            raise _UnfitError(f"is {value!r:.60}, not an object with {', '.join(readers)}")
        for name in readers:
            if name not in value and name not in optional:
                raise _UnfitError(f"has no {name}")
        for name in value.keys() - readers.keys() if closed else ():
            raise _UnfitError(f"has {printable_line(name):.60}, which is unknown")
        values = {n: _at(f".{n}", readers[n], value[n]) for n in readers if n in value}
        return kind(**values) if closed else value | values

    return read


def _at(step: str, reader: Reader, value: Any) -> Any:
    try:
        return reader(value)
    except _UnfitError as unfit:
        unfit.place = step + unfit.place
        raise

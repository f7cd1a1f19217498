"""Observations, rewards and states as bytes: equal values have equal bytes, in every process.

Everything that is compared, of any environment, is hashed here. Two different values have the same
64-bit digest with a probability of 2 ** -64.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterable, Iterator, Mapping
from collections.abc import Set as AbstractSet
from functools import lru_cache
from hashlib import blake2b
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.benchmarks.errors import FAILURES, EnvironmentFailure
from labyrinth_core.errors import one_line

DIGEST_BYTES = 8
SHOWN_VALUES = 8
"""The maximum size of an array whose values `leaves` shows."""
SHOWN_LETTERS = 60
"""The maximum length of a value that `leaves` shows in full."""


class IncomparableError(EnvironmentFailure, TypeError):
    """Two values of this type cannot be compared."""


def digest(*parts: bytes) -> int:
    """Return the 64-bit digest of bytes, as an unsigned number."""
    return int.from_bytes(blake2b(b"".join(parts), digest_size=DIGEST_BYTES).digest(), "little")


def encode(value: Any) -> bytes:
    """Return a value as bytes that tell where they end.

    The order of a dictionary's keys, the sign of a zero and the bits of a NaN make no difference.
    Arrays are copied into the result, so an environment may overwrite them afterwards.

    Args:
        value: Numbers, texts, arrays (of objects, too), and dictionaries, lists, tuples and sets
            of these; also whatever NumPy can convert to an array.

    Raises:
        IncomparableError: Two values of this type cannot be compared.
    """
    try:
        return _ENCODERS.get(type(value), _encode_other)(value)
    except RecursionError as error:
        raise IncomparableError("a value contains itself, or too many levels") from error


def _encode_array(value: NDArray[Any]) -> bytes:
    head = head_of(value)
    kind = value.dtype.kind
    if kind in "biuSUmM":
        return head + value.tobytes()
    if kind in "fc":
        return head + normalised(value).tobytes()
    if value.dtype.names:
        return head + b"".join(encode(value[name]) for name in value.dtype.names)
    return head + b"".join(map(encode, value.ravel().tolist()))


def normalised(value: NDArray[Any]) -> NDArray[Any]:
    """Return floats with one zero and one NaN."""
    value = value + 0.0  # The sum of -0.0 and 0.0 is 0.0.
    missing = value != value
    return np.where(missing, value.dtype.type("nan"), value) if missing.any() else value


def head_of(value: NDArray[Any]) -> bytes:
    """Return the bytes that come before an array's own: its type and shape."""
    return _head(value.dtype, value.shape)


@lru_cache(maxsize=1_000)
def _head(dtype: np.dtype[Any], shape: tuple[int, ...]) -> bytes:
    return b"a%s%r" % (dtype.str.encode(), shape)


def _encode_text(value: str) -> bytes:
    content = value.encode("utf-8", "surrogatepass")
    return b"s%d:%s" % (len(content), content)


def _encode_float(value: float) -> bytes:
    return b"n" if value != value else b"f" + struct.pack("<d", value + 0.0)


def _encode_mapping(value: Mapping[Any, Any]) -> bytes:
    pairs = sorted(encode(key) + encode(item) for key, item in value.items())
    return b"{%s}" % b"".join(pairs)


def _encode_sequence(value: Iterable[Any]) -> bytes:
    return b"(%s)" % b"".join(map(encode, value))


def _encode_set(value: AbstractSet[Any]) -> bytes:
    return b"<%s>" % b"".join(sorted(map(encode, value)))


_ENCODERS: dict[type, Callable[[Any], bytes]] = {
    np.ndarray: _encode_array,
    bool: lambda value: b"T" if value else b"F",
    np.bool_: lambda value: b"T" if value else b"F",
    **dict.fromkeys((int, np.int8, np.int32, np.int64, np.uint8), b"i%d;".__mod__),
    float: _encode_float,
    np.float64: _encode_float,
    str: _encode_text,
    bytes: lambda value: b"b%d:%s" % (len(value), value),
    type(None): lambda _: b"0",
    dict: _encode_mapping,
    tuple: _encode_sequence,
    list: _encode_sequence,
}


def _encode_other(value: Any) -> bytes:
    """Return a value of a rarer type, or of a subclass, as bytes."""
    kinds: dict[Any, Callable[[Any], bytes]] = {
        (bool, np.bool_): lambda item: encode(bool(item)),
        (int, np.integer): lambda item: encode(int(item)),
        (float, np.floating): lambda item: encode(float(item)),
        str: lambda item: _encode_text(str(item)),
        (bytes, bytearray): lambda item: encode(bytes(item)),
        Mapping: _encode_mapping,
        (tuple, list): _encode_sequence,
        AbstractSet: _encode_set,
    }
    for kind, encoder in kinds.items():
        if isinstance(value, kind):
            return encoder(value)
    try:
        array = np.asarray(value)
    except FAILURES as error:
        raise IncomparableError(f"{type(value).__qualname__}: {one_line(error):.200}") from error
    if array.dtype.kind == "O" and not isinstance(value, np.ndarray):
        raise IncomparableError(f"a value of type {type(value).__qualname__} cannot be compared")
    return _encode_array(array)


def leaves(value: Any, name: str) -> Iterator[tuple[str, str]]:
    """Yield the name and a short text of each part of a value, such as `observation['image']`.

    Two values of which `encode` returns the same have the same parts.

    Raises:
        IncomparableError: As for `encode`.
    """
    encode(value)
    yield from _leaves(value, name)


def _leaves(value: Any, name: str) -> Iterator[tuple[str, str]]:
    if isinstance(value, Mapping):
        for key in sorted(value, key=encode):
            yield from _leaves(value[key], f"{name}[{key!r}]")
        yield name, f"{len(value)} keys"
    elif isinstance(value, tuple | list):
        for index, item in enumerate(value):
            yield from _leaves(item, f"{name}[{index}]")
        yield name, f"{len(value)} items"
    elif isinstance(value, np.ndarray):
        yield name, _shown_array(value)
        yield f"{name}.dtype", str(value.dtype)
    else:
        yield name, _shown(value)


def _shown_array(value: NDArray[Any]) -> str:
    """Return the values of a small array of numbers, and the digest of another."""
    if 0 < value.size <= SHOWN_VALUES and value.dtype.kind in "biufcmMSU":
        shown = normalised(value) if value.dtype.kind in "fc" else value
        return _shortened(str(shown.tolist()), value)
    shape = " x ".join(map(str, value.shape))
    return f"{value.dtype} array of {shape}, digest {digest(encode(value)):016x}"


def _shown(value: Any) -> str:
    """Return a value without parts as text."""
    if isinstance(value, bool | np.bool_ | int | np.integer | None):
        return _shortened(str(value), value)
    if isinstance(value, float | np.floating):
        return str(float(value) + 0.0)  # As in `encode`.
    if isinstance(value, str | bytes):
        return _shortened(repr(str(value) if isinstance(value, str) else bytes(value)), value)
    return f"value with digest {digest(encode(value)):016x}"


def _shortened(text: str, value: Any) -> str:
    if len(text) <= SHOWN_LETTERS:
        return text
    return f"{text[:SHOWN_LETTERS]}... digest {digest(encode(value)):016x}"

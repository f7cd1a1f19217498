"""Observations, rewards and states as bytes: equal values have equal bytes, in every process.

Everything that is compared, of any environment, is hashed here. Two different values have the same
64-bit digest with a probability of 2 ** -64. `Tape` gathers everything that is seen of some seeds,
in less time than a quick step takes.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterable, Iterator, Mapping
from collections.abc import Set as AbstractSet
from functools import lru_cache
from hashlib import blake2b
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.benchmarks.environment import FAILURES, EnvironmentFailure, failure
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


class _Run(NamedTuple):
    """Observations in a row that are arrays of numbers of one type and shape, or none of them."""

    start: int
    """The place of the first among the parts of a tape."""
    dtype: np.dtype[Any] | None = None
    shape: tuple[int, ...] = ()
    opening: bytes = b""
    """What is before the bytes of an array that a step returned."""


class Tape:
    """The bytes of what is seen of some seeds, those of `encode`.

    Arrays of numbers are copied when they are seen, since an environment may overwrite them, and
    normalised together at the end.
    """

    def __init__(self) -> None:
        self._parts: list[bytes] = []
        """For each observation three parts: what is before it, its bytes, what is after it."""
        self._starts: list[int] = []
        """The place among the parts of the first observation of each episode."""
        self._run = _Run(0)
        self._runs = [self._run]
        self._reward: tuple[object, bytes, bytes] = object(), b"", b""
        """The last reward, if another can be the same object; its bytes; those of a usual step."""

    @property
    def size(self) -> int:
        """About how many bytes there are: all observations, if they were as large as the last."""
        return len(self._parts) // 3 * len(self._parts[-2]) if self._parts else 0

    def begin(self, observation: Any) -> None:
        """Add the first observation of an episode."""
        self._starts.append(len(self._parts))
        self._add(observation, b"", b"")

    def play(self, step: Callable[[Any], Any], actions: Iterable[Any]) -> None:
        """Take steps until the episode ends; add the observation, the reward and two flags of each.

        Args:
            step: Takes a step of the environment.
            actions: The actions.

        Raises:
            EnvironmentFailure: A step fails, or returns what cannot be compared.
        """
        # All in one loop and in local variables: a step of CartPole takes 6 microseconds.
        array, add = np.ndarray, self._parts.append
        run, (last, code, usual) = self._run, self._reward
        dtype, shape, opening = run.dtype, run.shape, run.opening
        for action in actions:
            try:
                observation, reward, terminated, truncated, _ = step(action)
                goes_on = terminated is truncated is False
                ended = not goes_on and bool(terminated or truncated)
            except FAILURES as error:
                raise failure(error) from error
            if reward is not last:
                code = encode(reward)
                usual = code + b"FF)"
                last = reward if type(reward) in (float, int) else object()
            if goes_on:
                closing = usual
            elif terminated is True and truncated is False:
                closing = code + b"TF)"
            else:
                closing = b"%s%s%s)" % (code, encode(terminated), encode(truncated))
            if (
                type(observation) is array
                and observation.dtype is dtype
                and observation.shape == shape
            ):
                add(opening)
                add(observation.tobytes())
                add(closing)
            else:
                self._add(observation, b"(", closing)
                run = self._run
                dtype, shape, opening = run.dtype, run.shape, run.opening
            if ended:
                break
        self._reward = last, code, usual

    def _add(self, observation: Any, opening: bytes, closing: bytes) -> None:
        run = self._run
        if type(observation) is np.ndarray and observation.dtype.kind in "biuf":
            if observation.dtype is not run.dtype or observation.shape != run.shape:
                opened = b"(" + head_of(observation)
                run = _Run(len(self._parts), observation.dtype, observation.shape, opened)
            opening, code = run.opening if opening else run.opening[1:], observation.tobytes()
        else:
            code = encode(observation)
            if run.dtype is not None:
                run = _Run(len(self._parts))
        if run is not self._run:
            self._run = run
            self._runs.append(run)
        self._parts += (opening, code, closing)

    def cut(self, episodes: int) -> None:
        """Drop all but the first episodes."""
        if episodes < len(self._starts):
            end = self._starts[episodes]
            del self._starts[episodes:], self._parts[end:]
            self._runs = [run for run in self._runs if run.start < end] or [_Run(0)]
            self._run = self._runs[-1]

    def seeds(self, probes: int) -> Iterator[tuple[list[bytes], bytes, list[NDArray[Any]]]]:
        """Normalise the arrays of numbers, and yield what was seen of each seed.

        Args:
            probes: The number of episodes of each seed.

        Yields:
            The bytes of the first observation of each episode; those of everything; and the
            observations that are arrays of numbers, stacked if alike and in a row.
        """
        parts, stacked = self._parts, [*self._normalise()]
        for place, (at, end) in enumerate(pairwise([*self._starts[::probes], len(parts)])):
            starts = self._starts[place * probes : (place + 1) * probes]
            first = [b"".join(parts[start : start + 3]) for start in starts]
            alike = [
                array[max(at - start, 0) // 3 : (end - start) // 3]
                for start, array in stacked
                if at - 3 * len(array) < start < end
            ]
            yield first, b"".join(parts[at:end]), alike

    def _normalise(self) -> Iterator[tuple[int, NDArray[Any]]]:
        """Normalise the arrays of numbers; yield the place of each run, and its arrays."""
        for run, end in pairwise([*self._runs, _Run(len(self._parts))]):
            if run.dtype is not None:
                place = slice(run.start + 1, end.start, 3)
                given = b"".join(self._parts[place])
                count = (end.start - run.start) // 3
                stacked = np.frombuffer(given, run.dtype).reshape(count, *run.shape)
                if run.dtype.kind == "f":
                    stacked = normalised(stacked)
                    if stacked.tobytes() != given:
                        self._parts[place] = [each.tobytes() for each in stacked]
                yield run.start, stacked

"""Everything that is seen of a seed as bytes, gathered in less time than a quick step takes."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.benchmarks.encoding import encode, head_of, normalised


class _Run(NamedTuple):
    """Observations in a row that are arrays of numbers of one type and shape, or none of them."""

    start: int
    """The place of the first among the parts of a tape."""
    dtype: np.dtype[Any] | None = None
    shape: tuple[int, ...] = ()
    head: bytes = b""
    opening: bytes = b""
    """What is before the bytes of an array that a step returned."""


class Tape:
    """The bytes of what is seen of a seed, those of `encode`.

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
        self._reward: object = self  # No reward yet: it may be None.
        """The last reward that is an immutable number, of a step that did not end an episode."""
        self._closing = b""
        """What is after the observation of such a step."""

    def begin(self, observation: Any) -> None:
        """Add the first observation of an episode."""
        self._starts.append(len(self._parts))
        self._add(observation, b"", b"")

    def step(self, seen: tuple[Any, Any, Any, Any]) -> None:
        """Add the observation, the reward, and whether the episode was terminated or truncated."""
        observation, reward, terminated, truncated = seen
        if reward is self._reward and terminated is truncated is False:
            closing = self._closing
        else:
            closing = b"%s%s%s)" % (encode(reward), encode(terminated), encode(truncated))
            if type(reward) in (float, int) and terminated is truncated is False:
                self._reward, self._closing = reward, closing
        run = self._run
        if (
            type(observation) is np.ndarray
            and observation.dtype is run.dtype
            and observation.shape == run.shape
        ):
            self._parts += (run.opening, observation.tobytes(), closing)
        else:
            self._add(observation, b"(", closing)

    def _add(self, observation: Any, opening: bytes, closing: bytes) -> None:
        if type(observation) is np.ndarray and observation.dtype.kind in "biuf":
            dtype, shape = observation.dtype, observation.shape
            if dtype is not self._run.dtype or shape != self._run.shape:
                head = head_of(observation)
                self._run = _Run(len(self._parts), dtype, shape, head, b"(" + head)
                self._runs.append(self._run)
            self._parts += (opening + self._run.head, observation.tobytes(), closing)
        else:
            if self._run.dtype is not None:
                self._run = _Run(len(self._parts))
                self._runs.append(self._run)
            self._parts += (opening, encode(observation), closing)

    def end(self) -> list[NDArray[Any]]:
        """Normalise the arrays of numbers, and return them, stacked if alike and in a row."""
        found = []
        ends = [*(run.start for run in self._runs[1:]), len(self._parts)]
        for run, end in zip(self._runs, ends, strict=True):
            if run.dtype is not None:
                place = slice(run.start + 1, end, 3)
                given = b"".join(self._parts[place])
                count = (end - run.start) // 3
                stacked = np.frombuffer(given, run.dtype).reshape(count, *run.shape)
                if run.dtype.kind == "f":
                    stacked = normalised(stacked)
                    if stacked.tobytes() != given:
                        self._parts[place] = [each.tobytes() for each in stacked]
                found.append(stacked)
        return found

    def first(self) -> list[bytes]:
        """Return the bytes of the first observation of each episode, after `end`."""
        return [b"".join(self._parts[at : at + 3]) for at in self._starts]

    def all(self) -> bytes:
        """Return the bytes of everything, after `end`."""
        return b"".join(self._parts)

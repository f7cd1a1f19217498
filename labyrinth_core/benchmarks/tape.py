"""Everything that is seen of some seeds as bytes, gathered in less time than a quick step takes."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.benchmarks.encoding import encode, head_of, normalised
from labyrinth_core.benchmarks.errors import FAILURES, failure


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

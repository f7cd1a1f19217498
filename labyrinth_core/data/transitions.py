"""The contents of a loaded dataset: episodes, and transitions (s, a, s') for learning."""

from __future__ import annotations

import errno
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, NamedTuple, overload

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.data.episodes import Episodes
from labyrinth_core.data.errors import DatasetError


@dataclass(frozen=True, eq=False)
class LoadedEpisode:
    """One episode of a dataset."""

    labyrinth_id: int
    info: str
    """The labyrinth in the text language."""
    observations: NDArray[Any]
    """Observations of the T + 1 states: uint8 (T + 1, size, size, 3), int32 (T + 1, length) or
    texts (T + 1,)."""
    actions: NDArray[np.int64]
    """Actions taken, shape (T,)."""
    rewards: NDArray[np.float32]
    """Rewards received, shape (T,)."""
    terminated: bool
    """Whether the episode ends on the goal or on ice, instead of being cut."""

    @property
    def truncated(self) -> bool:
        """Whether the episode was cut: an episode of a dataset is terminated or truncated."""
        return not self.terminated

    def __len__(self) -> int:
        """Return the number of transitions."""
        return len(self.actions)


class Transition(NamedTuple):
    """One step: state, action, next state."""

    observation: NDArray[Any]
    action: int
    next_observation: NDArray[Any]


class TransitionBatch(NamedTuple):
    """Several steps, along the first axis of each array."""

    observation: NDArray[Any]
    action: NDArray[np.int64]
    next_observation: NDArray[Any]


@dataclass(frozen=True, eq=False)
class Transitions:
    """All transitions of a split, in order; a map-style dataset for a `DataLoader`.

    Each state is kept once, and consecutive transitions share it; so all arrays are read-only.
    Arrays in a file of the cache are sent to other processes as the name of the file.
    """

    frames: NDArray[Any]
    """Observations of all states of all episodes, one after the other, shape (M, ...)."""
    rows: NDArray[np.int64]
    """Index in `frames` of each transition's state, shape (N,); the next state follows it."""
    actions: NDArray[np.int64]
    """Actions taken, shape (N,)."""
    rewards: NDArray[np.float32]
    """Rewards received, shape (N,)."""
    terminated: NDArray[np.bool_]
    """Whether the transition ends its episode on the goal or on ice, shape (N,)."""
    labyrinth_ids: NDArray[np.int64]
    """The id of each transition's labyrinth, shape (N,); elsewhere it is `f"{id:016x}"`."""
    optimal: NDArray[np.bool_] | None = None
    """Which of the four actions begin a shortest route, shape (N, 4), if it was asked for."""

    def __post_init__(self) -> None:
        for each in fields(self):
            array = getattr(self, each.name)
            if array is not None:
                array.setflags(write=False)

    def __len__(self) -> int:
        """Return the number of transitions, N."""
        return len(self.rows)

    def __repr__(self) -> str:
        """Return the number of transitions and of labyrinths, and what an observation is."""
        labyrinths = len(np.unique(self.labyrinth_ids))
        shape, kind = self.frames.shape[1:], self.frames.dtype
        return f"Transitions({len(self)} of {labyrinths} labyrinths; observations {shape} {kind})"

    @property
    def truncated(self) -> NDArray[np.bool_]:
        """Whether the transition ends an episode that was cut, shape (N,)."""
        return self.dones & ~self.terminated

    @property
    def dones(self) -> NDArray[np.bool_]:
        """Whether the transition ends its episode, terminated or truncated, shape (N,)."""
        # The last state of an episode, in which no action is taken, lies before the next one.
        dones: NDArray[np.bool_] = np.diff(self.rows, append=len(self.frames)) != 1
        return dones

    @property
    def episode_indices(self) -> NDArray[np.int64]:
        """The number of each transition's episode in the split, from 0, shape (N,)."""
        # Each episode before it has one state more than transitions.
        numbers: NDArray[np.int64] = self.rows - np.arange(len(self.rows))
        return numbers

    @property
    def observations(self) -> NDArray[Any]:
        """The observations before the actions, shape (N, ...); a new array."""
        return self.frames.take(self.rows, axis=0)

    @property
    def next_observations(self) -> NDArray[Any]:
        """The observations after the actions, shape (N, ...); a new array."""
        return self.frames.take(self.rows + 1, axis=0)

    @overload
    def __getitem__(self, index: int) -> Transition: ...

    @overload
    def __getitem__(self, index: slice | Sequence[int] | NDArray[np.int64]) -> TransitionBatch: ...

    def __getitem__(
        self, index: int | slice | Sequence[int] | NDArray[np.int64]
    ) -> Transition | TransitionBatch:
        """Return one transition as views of `frames`, or a batch as new arrays."""
        rows = self.rows[index]
        if isinstance(rows, np.ndarray):
            return TransitionBatch(
                self.frames.take(rows, axis=0),
                np.array(self.actions[index]),
                self.frames.take(rows + 1, axis=0),
            )
        return Transition(self.frames[rows], int(self.actions[index]), self.frames[rows + 1])

    def __getitems__(self, indices: Sequence[int]) -> list[Transition]:
        """Return several transitions in new memory; a `DataLoader` calls this for a batch.

        Read-only arrays make tensors that are not to be written to.
        """
        batch = self[np.asarray(indices, np.int64)]
        steps = zip(batch.observation, batch.action.tolist(), batch.next_observation, strict=True)
        return [Transition(*step) for step in steps]

    def __iter__(self) -> Iterator[Transition]:
        """Yield all transitions in order."""
        return (self[index] for index in range(len(self)))

    def __reduce__(self) -> tuple[object, ...]:
        """Return how to pickle the transitions: arrays of a file by its name."""
        return _received, tuple(_sent(getattr(self, field.name)) for field in fields(self))


def _received(*sent: Any) -> Transitions:
    return Transitions(*(_received_array(*e) if isinstance(e, tuple) else e for e in sent))


def _sent(array: NDArray[Any] | None) -> NDArray[Any] | tuple[Any, ...] | None:
    """Return an array, or the arguments of `mapped` if it is mapped from a file."""
    base: Any = array
    while base is not None and not isinstance(base, np.memmap):
        base = getattr(base, "base", None)
    # What may have been written to is not, or should not be, in the file.
    if array is None or base is None or base.flags.writeable or not base.filename:
        return array
    if not array.flags.c_contiguous:
        return array
    offset = base.offset + array.ctypes.data - base.ctypes.data
    return str(base.filename), array.dtype, offset, array.shape


def _received_array(path: str, *layout: Any) -> NDArray[Any]:
    """Return the array that `_sent` described.

    Raises:
        DatasetError: The file is gone or has become shorter.
    """
    try:
        return mapped(path, *layout)
    except (OSError, ValueError) as error:
        raise DatasetError(f"{path} is gone since it was loaded: {error}") from error


def mapped(
    path: str | Path, dtype: Any, offset: int = 0, shape: tuple[int, ...] | None = None
) -> NDArray[Any]:
    """Return an array in a file, read-only; see `numpy.memmap`.

    A tensor made of the array can be written to all the same, which crashes a process where the
    memory is mapped as read-only. So the memory is mapped as writable, and what is written stays in
    this process. Linux refuses such a mapping of a file that is larger than all memory, which is
    then mapped as read-only.
    """
    try:
        array = np.memmap(path, dtype, "c", offset, shape)
    except OSError as error:
        if error.errno != errno.ENOMEM:
            raise
        array = np.memmap(path, dtype, "r", offset, shape)
    array.setflags(write=False)
    return np.asarray(array)


Columns = Mapping[str, NDArray[Any]]
"""The fields of `Transitions` except the frames and `optimal`."""

COLUMNS: dict[str, np.dtype[Any]] = {
    "rows": np.dtype("<i8"),
    "actions": np.dtype("<i8"),
    "rewards": np.dtype("<f4"),
    "terminated": np.dtype("?"),
    "labyrinth_ids": np.dtype("<i8"),
}
"""Name of a column -> its type."""


def columns_of(episodes: Episodes, first: int) -> Columns:
    """Return the columns of the transitions of episodes, whose first row is that of a number."""
    steps, rows = np.flatnonzero(episodes.acting), episodes.whole.rows
    return {
        "rows": first + steps,
        "actions": rows.actions[steps],
        "rewards": rows.rewards[steps],
        "terminated": episodes.over[steps + 1],
        "labyrinth_ids": episodes.ids[episodes.which[steps]],
    }


def joined_columns(parts: Sequence[Columns]) -> Columns:
    """Return consecutive columns as one, of the types of `COLUMNS`."""
    return {
        name: np.concatenate([part[name] for part in parts]).astype(dtype, copy=False)
        for name, dtype in COLUMNS.items()
    }


def loaded(episodes: Episodes, observations: NDArray[Any]) -> Iterator[LoadedEpisode]:
    """Yield episodes one by one, each with arrays of its own, given the observation in each row."""
    rows, firsts, lasts = episodes.whole
    for first, last in zip(firsts.tolist(), lasts.tolist(), strict=True):
        yield LoadedEpisode(
            labyrinth_id=int(episodes.ids[episodes.which[first]]),
            info=rows.texts[rows.info[first]],
            observations=observations[first : last + 1].copy(),
            actions=rows.actions[first:last].copy(),
            rewards=rows.rewards[first:last].copy(),
            terminated=bool(episodes.over[last]),
        )

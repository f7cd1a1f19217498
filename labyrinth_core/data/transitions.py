"""Transitions (s, a, s'), and their cache on disk, so that pictures are made only once.

A cache is a folder with one array per file, mapped into memory: the observations of all states and
the columns of their transitions. Beside them is a SHA-256 of the folder's name and the columns;
hashing the observations would take as long as reading them. A damaged folder is made again.

One process makes a folder under a lock, and others wait for it; see `folders.WholeFolder`.
"""

from __future__ import annotations

import errno
import hashlib
import math
import os
import re
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, fields
from pathlib import Path
from tokenize import TokenError
from typing import Any, NamedTuple, overload

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from labyrinth_core.data.dataset_config import SPLITS
from labyrinth_core.data.format import OTHERS
from labyrinth_core.errors import DatasetError
from labyrinth_core.folders import WholeFolder
from labyrinth_core.storage import LocalFile

LIMIT_VARIABLE, LIMIT = "LABYRINTH_CACHE_GB", "20"
"""Environment variable that limits all caches in a folder, in gigabytes; its default."""

LARGE = 500_000_000
"""From this many bytes on, a warning announces that pictures are being written."""

Columns = Mapping[str, NDArray[Any]]
"""Fields of `Transitions` by name."""

COLUMNS: dict[str, np.dtype[Any]] = {
    "rows": np.dtype("<i8"),
    "actions": np.dtype("<i8"),
    "rewards": np.dtype("<f4"),
    "terminated": np.dtype("?"),
    "labyrinth_ids": np.dtype("<i8"),
    **{column.name: column.dtype for column in OTHERS},
}
"""The fields of `Transitions` except the frames and `optimal`, and its `columns` -> their types."""

FRAMES, SUM = "frames.npy", "sha256"
_FILES = (FRAMES, *(f"{name}.npy" for name in COLUMNS), SUM)
_NAME = re.compile(rf".+-({'|'.join(SPLITS)})-\d+-[0-9a-f]{{32}}", re.ASCII)

Content = Iterable[tuple[NDArray[np.uint8], Columns]]
"""Frames, shape (any number, ...), with the columns of their transitions, in order."""


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

    Each state is stored once and shared by consecutive transitions, so all arrays are read-only.
    Arrays from the cache are pickled as the names of their files.
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
    """The id of each transition's labyrinth, shape (N,); files hold it as `f"{id:016x}"`."""
    optimal: NDArray[np.bool_] | None = None
    """Which of the four actions begin a shortest route, shape (N, 4); None unless requested."""
    columns: Mapping[str, NDArray[Any]] = field(default_factory=dict)
    """The dataset's other columns (`format.OTHERS`) by name, in each transition's state, (N,)."""

    def __post_init__(self) -> None:
        own = (getattr(self, each.name) for each in fields(self) if each.name != "columns")
        for array in (*own, *self.columns.values()):
            if array is not None:
                array.setflags(write=False)

    @classmethod
    def of(cls, arrays: Columns) -> Transitions:
        """Return the transitions of a cache's arrays."""
        own: dict[str, Any] = dict(arrays)
        own["columns"] = {column.name: own.pop(column.name) for column in OTHERS}
        return cls(**own)

    def __len__(self) -> int:
        """Return the number of transitions, N."""
        return len(self.rows)

    def __repr__(self) -> str:
        """Return the number of transitions and labyrinths, and an observation's shape and dtype."""
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
        # After an episode's last transition, `frames` has its last state, which has no action.
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
            if rows.ndim != 1:  # As for True, None and arrays of two axes.
                shown = " ".join(repr(index).split())
                raise IndexError(
                    f"index={shown:.60}: give a number, a slice, or one axis of numbers or booleans"
                )
            return TransitionBatch(
                self.frames.take(rows, axis=0),
                np.array(self.actions[index]),
                self.frames.take(rows + 1, axis=0),
            )
        return Transition(self.frames[rows], int(self.actions[index]), self.frames[rows + 1])

    def __getitems__(self, indices: Sequence[int]) -> list[Transition]:
        """Return copies of several transitions; a `DataLoader` calls this for a batch.

        Read-only views would make tensors that must not be written to.
        """
        batch = self[np.asarray(indices, np.int64)]
        steps = zip(batch.observation, batch.action.tolist(), batch.next_observation, strict=True)
        return [Transition(*step) for step in steps]

    def __iter__(self) -> Iterator[Transition]:
        """Yield all transitions in order."""
        return (self[index] for index in range(len(self)))

    def __reduce__(self) -> tuple[object, ...]:
        """Return how to pickle the transitions; whole arrays of a cache become file names."""
        sent = {name: _sent(array) for name, array in self.columns.items()}
        return _received, (sent, *(_sent(getattr(self, each.name)) for each in fields(self)[:-1]))


def _sent(array: NDArray[Any] | None) -> NDArray[Any] | str | None:
    """Return an array, or the name of its file if it is the whole array of a cache."""
    base = None if array is None else array.base
    if array is None or not isinstance(base, np.memmap) or base.flags.writeable:
        return array
    whole = (array.dtype, array.shape) == (base.dtype, base.shape) and array.flags.c_contiguous
    return str(base.filename) if whole and str(base.filename).endswith(".npy") else array


def _received(columns: Mapping[str, Any], *sent: Any) -> Transitions:
    own = {name: _mapped(array) for name, array in columns.items()}
    return Transitions(*(*map(_mapped, sent), own))


def _mapped(sent: Any) -> Any:
    if not isinstance(sent, str):
        return sent
    path = sent
    try:
        return mapped(path)
    except (OSError, ValueError) as error:
        raise DatasetError(f"{path} is gone since it was loaded: {error}") from error


def name_of(config: str, split: str, image_size: int, content: tuple[Any, ...]) -> str:
    """Return the name of a cache's folder; `content` is all else that its data depend on."""
    key = hashlib.sha256(repr((image_size, *content)).encode()).hexdigest()
    return f"{config}-{split}-{image_size}-{key[:32]}"


def user_folder() -> Path:
    """Return the default folder of caches (XDG Base Directory Specification, version 0.8).

    Raises:
        OSError: The home folder of the user is unknown.
    """
    base = Path(os.environ.get("XDG_CACHE_HOME", ""))
    try:  # The specification says to ignore relative paths.
        return (base if base.is_absolute() else Path.home() / ".cache") / "labyrinth-datasets"
    except RuntimeError as error:
        raise OSError(str(error)) from error


def cached(folder: Path, shape: tuple[int, ...], content: Content) -> Columns:
    """Return the frames and columns of a cache, which is made if it is missing or damaged.

    If all caches together would exceed the limit, the least recently used are removed.

    Args:
        folder: The folder, with a name from `name_of`.
        shape: The shape of all frames together.
        content: The data of the cache; iterated only if the folder has to be made.

    Raises:
        OSError: The folder can be neither read nor made.
        DatasetError: The frames exceed the limit by themselves, or the limit is not a number.
    """
    lock = folder.with_name(f".{folder.name}.lock")
    columns = _read(folder, shape)
    if columns is not None:
        if lock.exists():  # A process was killed just after it had made the folder.
            _remove_leftovers(folder.parent)
        return columns
    size, most = math.prod(shape), _limit()
    if size > most:
        raise DatasetError(
            f"the pictures take {size / 1e9:.1f} GB, and the limit is {most / 1e9:g} GB: give a "
            f"smaller image_size, a higher {LIMIT_VARIABLE}, or cache_dir=False to use memory"
        )
    if size >= LARGE:
        warnings.warn(f"writing {size / 1e9:.1f} GB of pictures to {folder}", stacklevel=4)
    folder.parent.mkdir(parents=True, exist_ok=True)
    _remove_leftovers(folder.parent)
    with LocalFile(lock).locked():
        if _read(folder, shape) is None:  # No other process has made it meanwhile.
            _remove_unfinished(folder)
            _make_room(folder, most - size)
            _make(folder, shape, content)
    columns = _read(folder, shape)
    if columns is None:
        raise OSError(f"{folder} was written, but does not read back the same")
    return columns


def _limit() -> int:
    """Return the limit of all caches in a folder in bytes, from the environment."""
    text = os.environ.get(LIMIT_VARIABLE, LIMIT)
    with suppress(ValueError):
        if 0 <= float(text) < math.inf:
            return int(float(text) * 1e9)
    raise DatasetError(f"{LIMIT_VARIABLE}={text}: give a number of gigabytes, such as {LIMIT}")


def _read(folder: Path, shape: tuple[int, ...]) -> Columns | None:
    """Return the arrays in a folder, None if it is missing or damaged."""
    try:
        frames = mapped(folder / FRAMES)
        columns = {name: mapped(folder / f"{name}.npy") for name in COLUMNS}
        digest = (folder / SUM).read_bytes()
    except (FileNotFoundError, ValueError):
        return None
    types = {name: array.dtype for name, array in columns.items()}
    if frames.dtype != np.uint8 or frames.shape != shape or types != COLUMNS:
        return None
    if digest != _digest(folder.name, columns):
        return None
    with suppress(OSError):  # The folder may be read-only.
        os.utime(folder / FRAMES)
    return {"frames": frames, **columns}


def mapped(path: str | Path) -> NDArray[Any]:
    """Return the read-only array of a .npy file, mapped into memory.

    PyTorch tensors made from the array ignore its read-only flag, and writing to memory that is
    mapped read-only crashes the process. So the mapping is copy-on-write: writes stay in this
    process. Linux refuses such a mapping for a file larger than all memory; that file is mapped
    read-only.

    Raises:
        OSError: The file cannot be read.
        ValueError: The file is damaged.
    """
    try:
        try:
            array = npy.open_memmap(path, mode="c")
        except OSError as error:
            if error.errno != errno.ENOMEM:
                raise
            array = npy.open_memmap(path, mode="r")
    except (SyntaxError, TokenError, OverflowError) as error:  # NumPy's, for damaged headers.
        raise ValueError(str(error)) from error
    array.setflags(write=False)
    return np.asarray(array)


def _digest(name: str, columns: Columns) -> bytes:
    """Return the hash of the name of a cache and of its columns."""
    digest = hashlib.sha256(repr((name, [array.shape for array in columns.values()])).encode())
    for array in columns.values():
        digest.update(array.data)
    return digest.hexdigest().encode()


def joined_columns(parts: Sequence[Columns]) -> Columns:
    """Concatenate consecutive columns, with the dtypes of `COLUMNS`."""
    return {
        name: np.concatenate([part[name] for part in parts]).astype(dtype, copy=False)
        for name, dtype in COLUMNS.items()
    }


def _make(folder: Path, shape: tuple[int, ...], content: Content) -> None:
    """Make the folder of a cache, and replace a damaged one."""
    parts = []

    def frames() -> Iterator[NDArray[np.uint8]]:
        for some, columns in content:
            parts.append(columns)
            yield some

    _require_own(folder)
    with LocalFile(folder).naming(), WholeFolder.of(folder, SUM).made() as made:
        _save(made / FRAMES, np.dtype(np.uint8), shape, frames())
        joined = joined_columns(parts)
        for name, array in joined.items():
            _save(made / f"{name}.npy", array.dtype, array.shape, [array])
        (made / SUM).write_bytes(_digest(folder.name, joined))


def _save(
    path: Path, dtype: np.dtype[Any], shape: tuple[int, ...], parts: Iterable[NDArray[Any]]
) -> None:
    """Write an array, given in parts, to a .npy file.

    The file is not mapped: on a full disk, writing to mapped memory kills the process.
    """
    with path.open("wb") as file:
        header = {"descr": npy.dtype_to_descr(dtype), "fortran_order": False, "shape": shape}
        npy.write_array_header_1_0(file, header)
        for part in parts:
            file.write(np.ascontiguousarray(part).data)


def _require_own(folder: Path) -> None:
    """Raise OSError if the folder of a cache is a file, or also holds files of others."""
    for path in folder.iterdir() if folder.exists() else ():
        if path.name not in _FILES:
            raise OSError(errno.ENOTEMPTY, "is no file of a cache: move it away", str(path))


def _make_room(folder: Path, most: int) -> None:
    """Remove the least recently used caches beside a folder until at most `most` bytes are used."""
    used = {}
    for path in folder.parent.iterdir():
        if _NAME.fullmatch(path.name) and path.is_dir() and path != folder:
            files = {file.name: file.stat() for file in path.iterdir()}
            if FRAMES in files and files.keys() <= {*_FILES}:
                size = sum(status.st_size for status in files.values())
                used[path] = files[FRAMES].st_mtime, size
    total = sum(size for _, size in used.values())
    for path, (_, size) in sorted(used.items(), key=lambda item: item[1]):
        if total > most:
            LocalFile(path).remove()
            total -= size


def _remove_leftovers(folder: Path) -> None:
    """Remove what killed processes have left: unfinished caches whose lock no process holds."""
    for lock in folder.glob(".*.lock"):
        name = lock.name.removesuffix(".lock")[1:]
        if _NAME.fullmatch(name):
            with suppress(OSError), LocalFile(lock).locked(wait=False):
                _remove_unfinished(folder / name)


def _remove_unfinished(folder: Path) -> None:
    """Remove what killed processes have left of one cache, whose lock the caller holds."""
    WholeFolder.of(folder, SUM).recover()
    for unfinished in LocalFile.temporaries(folder.parent, [folder.name]):
        LocalFile(unfinished).remove()

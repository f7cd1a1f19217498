"""Transitions in a file that is mapped into memory, so that pictures are decoded only once.

A cache file is the fields of `Transitions` one after the other, each in the format .npy and padded
to a multiple of 64 bytes, and a SHA-256 of the key, the shapes and all content but the frames. As
the frames come first, `numpy.load` reads them. A file that is cut short, or of another key, is
told apart and made again. The frames themselves are not hashed when a file is opened: that would
be to read them all.

A file is written under another name and renamed when it is whole, by one process that holds a lock;
others wait for it, and then find the file.
"""

from __future__ import annotations

import hashlib
import math
import os
import re
import warnings
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from labyrinth_core.data.errors import DatasetError
from labyrinth_core.data.locks import locked
from labyrinth_core.data.splits import SPLITS
from labyrinth_core.data.transitions import Fill, Transitions

FRAMES = np.dtype("u1")
COLUMNS: dict[str, np.dtype[Any]] = {
    "rows": np.dtype("<i8"),
    "actions": np.dtype("<i8"),
    "rewards": np.dtype("<f4"),
    "dones": np.dtype("?"),
    "labyrinth_ids": np.dtype("<i8"),
}
"""Field of `Transitions` -> its type in the file, in the order in which they follow the frames."""

SUFFIX = ".frames.npy"
"""The end of the names of cache files, so that leftovers are known from files of others."""

_NAME = re.compile(rf".+-({'|'.join(SPLITS)})-\d+-[0-9a-f]{{16}}{re.escape(SUFFIX)}", re.ASCII)
"""The names of cache files, see `name_of`."""

LIMIT_VARIABLE, LIMIT = "LABYRINTH_CACHE_GB", "20"
"""The environment variable for the most gigabytes in a folder, and its default."""

LARGE = 500_000_000
"""The bytes of a file from which on it is said that it is written."""

_ALIGNMENT = 64


def name_of(config: str, split: str, image_size: int, key: str) -> str:
    """Return the name of a cache file."""
    return f"{config}-{split}-{image_size}-{key[:16]}{SUFFIX}"


def user_folder() -> Path:
    """Return where caches lie by default (XDG Base Directory Specification, version 0.8).

    Raises:
        OSError: The home folder of the user is unknown.
    """
    base = Path(os.environ.get("XDG_CACHE_HOME", ""))
    if not base.is_absolute():  # The specification has relative paths ignored.
        try:
            base = Path.home() / ".cache"
        except RuntimeError as error:
            raise OSError(str(error)) from error
    return base / "labyrinth-datasets"


def limit() -> int:
    """Return how many bytes the cache files of a folder may have, by the environment.

    Raises:
        DatasetError: `LABYRINTH_CACHE_GB` is no number of gigabytes.
    """
    text = os.environ.get(LIMIT_VARIABLE, LIMIT)
    try:
        gigabytes = float(text)
    except ValueError:
        gigabytes = -1.0
    if not 0 <= gigabytes < math.inf:
        raise DatasetError(f"{LIMIT_VARIABLE}={text}: give a number of gigabytes, such as {LIMIT}")
    return int(gigabytes * 1e9)


def load(path: Path, key: str, size: int, fill: Fill) -> Transitions:
    """Return the transitions of a cache file, made by `fill` if it is missing or wrong.

    All that its content depends on is in the key. Files that were not used for the longest time
    make room for it, where there would be more than the limit; it says so if it gets large.

    Args:
        path: The file.
        key: What the content is known by.
        size: The bytes that the frames will have.
        fill: Makes the content.

    Raises:
        OSError: The file can be neither read nor made.
        DatasetError: It exceeds the limit by itself, or the limit is no number.
    """
    found = read(path, key)
    if found is not None:
        with suppress(OSError):  # A folder that may only be read.
            os.utime(path)
        return found
    most = limit()
    if size > most:
        raise DatasetError(
            f"the pictures are {size / 1e9:.1f} GB, and the cache may have {most / 1e9:g}: give a "
            f"smaller image_size, a higher {LIMIT_VARIABLE}, or cache_dir=False for the memory"
        )
    if size >= LARGE:
        warnings.warn(f"writing {size / 1e9:.1f} GB of pictures to {path}", stacklevel=3)
    path.parent.mkdir(parents=True, exist_ok=True)
    _remove_leftovers(path.parent)
    with locked(path.with_name(f".{path.name}.lock")):
        found = read(path, key)
        if found is None:
            temporary = path.with_name(f".{path.name}.tmp")
            _make_room(path, most - size)
            try:
                _write(temporary, key, fill)
                temporary.replace(path)
            finally:
                temporary.unlink(missing_ok=True)
            found = read(path, key)
    if found is None:
        raise OSError(f"{path} was made, but is not what was written")
    return found


def read(path: Path, key: str) -> Transitions | None:
    """Return the transitions of a cache file, None if it is missing, damaged or of another key.

    Raises:
        OSError: The file cannot be read.
    """
    try:
        with path.open("rb") as file:
            mapped = np.asarray(np.memmap(path, np.uint8, "r"))
            frames = _next(file, mapped, FRAMES)
            columns = {name: _next(file, mapped, dtype) for name, dtype in COLUMNS.items()}
            digest = file.read()
    except (FileNotFoundError, ValueError, OverflowError):
        return None
    if digest != _digest(key, frames.shape, columns):
        return None
    return Transitions(frames, **columns)


def _next(file: BinaryIO, mapped: NDArray[np.uint8], dtype: np.dtype[Any]) -> NDArray[Any]:
    """Return the mapped array that begins where a file is read; raise ValueError if none does."""
    npy.read_magic(file)
    shape, _, found = npy.read_array_header_1_0(file)
    if found != dtype or min(shape) < 1:
        raise ValueError(f"shape {shape} and type {found}, instead of type {dtype}")
    begin = file.tell()
    end = begin + math.prod(shape) * dtype.itemsize
    file.seek(-(-end // _ALIGNMENT) * _ALIGNMENT)
    return mapped[begin:end].view(dtype).reshape(shape)


def _digest(key: str, frames: tuple[int, ...], columns: Mapping[str, NDArray[Any]]) -> bytes:
    """Return the hash of a key, the shape of the frames, and the other arrays."""
    shapes = [frames, *(array.shape for array in columns.values())]
    digest = hashlib.sha256(repr((key, shapes)).encode())
    for array in columns.values():
        digest.update(array.data)
    return digest.digest()


def _write(path: Path, key: str, fill: Fill) -> None:
    """Write a cache file, which is on the disk when this returns."""
    with path.open("wb") as file:
        shape: tuple[int, ...] = ()

        def keep(observations: NDArray[Any]) -> None:
            nonlocal shape
            if not shape:  # The number of frames is filled in at the end.
                shape = (0, *observations.shape[1:])
                _write_header(file, shape)
            file.write(np.ascontiguousarray(observations).data)
            shape = (shape[0] + len(observations), *shape[1:])

        arrays = fill(keep)
        columns = {name: arrays[name].astype(dtype) for name, dtype in COLUMNS.items()}
        _pad(file)
        for array in columns.values():
            npy.write_array(file, array, (1, 0))
            _pad(file)
        file.write(_digest(key, shape, columns))
        file.seek(0)
        _write_header(file, shape)
        file.flush()
        # Else, after a power failure, the name could be there without the content.
        os.fsync(file.fileno())


def _write_header(file: BinaryIO, shape: tuple[int, ...]) -> None:
    """Write what the frames begin with, of the same length for any number of them."""
    header = {"descr": FRAMES.str, "fortran_order": False, "shape": shape}
    npy.write_array_header_1_0(file, header)


def _pad(file: BinaryIO) -> None:
    file.write(bytes(-file.tell() % _ALIGNMENT))


def _make_room(path: Path, most: int) -> None:
    """Remove the cache files beside a path that were used least recently, down to so many bytes."""
    others = [each for each in path.parent.iterdir() if _NAME.fullmatch(each.name) and each != path]
    states = sorted(((each.stat(), each) for each in others), key=lambda pair: pair[0].st_mtime)
    total = sum(state.st_size for state, _ in states)
    for state, each in states:
        if total <= most:
            break
        each.unlink(missing_ok=True)
        total -= state.st_size


def _remove_leftovers(folder: Path) -> None:
    """Remove what killed processes have left: files whose lock nobody holds."""
    for lock in folder.glob(f".*{SUFFIX}.lock"):
        with suppress(OSError), locked(lock, wait=False):  # Else another process holds it.
            lock.with_suffix(".tmp").unlink(missing_ok=True)

"""Transitions in a file that is mapped into memory, so that pictures are made only once.

A cache file holds the fields of `Transitions` one after the other, each in the format .npy and
padded to a multiple of 64 bytes, then a SHA-256 of the key, the shapes, and all content but the
frames, which would take as long to hash as to read. The frames come first, so `numpy.load` reads
them. A file that is cut short, or has another key, is made again.

One process writes a file, under a lock and another name, and renames it; others wait for it.
"""

from __future__ import annotations

import hashlib
import math
import os
import re
import warnings
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from tokenize import TokenError
from typing import Any, BinaryIO

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from labyrinth_core.data.errors import DatasetError
from labyrinth_core.data.locks import locked
from labyrinth_core.data.splits import SPLITS
from labyrinth_core.data.storage import file_at, replacing, temporaries
from labyrinth_core.data.transitions import COLUMNS, Columns, Transitions, joined_columns, mapped

SUFFIX = ".frames.npy"
"""The end of the names of cache files."""

_NAME = re.compile(rf".+-({'|'.join(SPLITS)})-\d+-[0-9a-f]{{16}}{re.escape(SUFFIX)}", re.ASCII)

LIMIT_VARIABLE, LIMIT = "LABYRINTH_CACHE_GB", "20"
"""The environment variable for the most gigabytes of cache files in a folder, and its default."""

LARGE = 500_000_000
"""The bytes from which on the writing of a file is announced."""

_ALIGNMENT = 64

Content = Iterable[tuple[NDArray[np.uint8], Columns]]
"""Frames, shape (any number, ...), with the columns of their transitions, in order."""


def name_of(config: str, split: str, image_size: int, key: str) -> str:
    """Return the name of a cache file."""
    return f"{config}-{split}-{image_size}-{key[:16]}{SUFFIX}"


def user_folder() -> Path:
    """Return the default folder of caches (XDG Base Directory Specification, version 0.8).

    Raises:
        OSError: The home folder of the user is unknown.
    """
    base = Path(os.environ.get("XDG_CACHE_HOME", ""))
    if not base.is_absolute():  # The specification says to ignore relative paths.
        try:
            base = Path.home() / ".cache"
        except RuntimeError as error:
            raise OSError(str(error)) from error
    return base / "labyrinth-datasets"


def load(path: Path, key: str, shape: tuple[int, ...], content: Content) -> Transitions:
    """Return the transitions of a cache file, which is made if it is missing or wrong.

    The files that were used least recently are removed if the folder would exceed its limit.

    Args:
        path: The file.
        key: Identifies the content: everything that it depends on.
        shape: The shape of all frames together.
        content: What the file holds; iterated only to make it.

    Raises:
        OSError: The file can be neither read nor made.
        DatasetError: The file exceeds the limit by itself, or the limit is not a number.
    """
    found = _read(path, key)
    if found is not None:
        with suppress(OSError):  # The folder may be read-only.
            os.utime(path)
        return found
    size, most = math.prod(shape), _limit()
    if size > most:
        raise DatasetError(
            f"the pictures are {size / 1e9:.1f} GB, and the cache may have {most / 1e9:g}: give a "
            f"smaller image_size, a higher {LIMIT_VARIABLE}, or cache_dir=False for the memory"
        )
    if size >= LARGE:
        warnings.warn(f"writing {size / 1e9:.1f} GB of pictures to {path}", stacklevel=4)
    path.parent.mkdir(parents=True, exist_ok=True)
    _remove_leftovers(path.parent)
    with locked(path.with_name(f".{path.name}.lock")):
        found = _read(path, key)
        if found is None:
            _make_room(path, most - size)
            with replacing(path) as temporary:
                _write(temporary, key, shape, content)
            found = _read(path, key)
    if found is None:
        raise OSError(f"{path} was made, but is not what was written")
    return found


def _limit() -> int:
    """Return the most bytes that the cache files of a folder may have, by the environment."""
    text = os.environ.get(LIMIT_VARIABLE, LIMIT)
    with suppress(ValueError):
        if 0 <= float(text) < math.inf:
            return int(float(text) * 1e9)
    raise DatasetError(f"{LIMIT_VARIABLE}={text}: give a number of gigabytes, such as {LIMIT}")


def _read(path: Path, key: str) -> Transitions | None:
    """Return the transitions of a file, None if it is missing or damaged, or has another key."""
    try:
        frames, columns, digest = _parts(path)
    except (FileNotFoundError, ValueError):
        return None
    return Transitions(frames, **columns) if digest == _digest(key, frames.shape, columns) else None


def _parts(path: Path) -> tuple[NDArray[Any], Columns, bytes]:
    """Return the frames, the columns and the hash in a cache file; ValueError for another file."""
    with file_at(path).open("rb") as file:
        content = mapped(path, np.uint8)
        frames = _next(file, content, np.dtype("u1"))
        columns = {name: _next(file, content, dtype) for name, dtype in COLUMNS.items()}
        return frames, columns, file.read()


def _is_cache(path: Path) -> bool:
    """Return whether a file with the name of a cache file is one, of any key."""
    try:
        return len(_parts(path)[2]) == hashlib.sha256().digest_size
    except (OSError, ValueError):
        return False


def _next(file: BinaryIO, content: NDArray[np.uint8], dtype: np.dtype[Any]) -> NDArray[Any]:
    """Return the mapped array that begins where a file is read, or raise ValueError."""
    npy.read_magic(file)
    try:
        shape, _, found = npy.read_array_header_1_0(file)
    except (SyntaxError, TokenError) as error:  # Of numpy, for some damaged headers.
        raise ValueError(str(error)) from error
    if found != dtype or min(shape) < 1:
        raise ValueError(f"shape {shape} and type {found}, instead of type {dtype}")
    begin = file.tell()
    end = begin + math.prod(shape) * dtype.itemsize
    file.seek(-(-end // _ALIGNMENT) * _ALIGNMENT)
    return content[begin:end].view(dtype).reshape(shape)


def _digest(key: str, frames: tuple[int, ...], columns: Columns) -> bytes:
    """Return the hash of a key, the shape of the frames, and the other arrays."""
    shapes = [frames, *(array.shape for array in columns.values())]
    digest = hashlib.sha256(repr((key, shapes)).encode())
    for array in columns.values():
        digest.update(array.data)
    return digest.digest()


def _write(path: Path, key: str, shape: tuple[int, ...], content: Content) -> None:
    """Write a cache file, which is on the disk when this returns."""
    with path.open("wb") as file:
        header = {"descr": "|u1", "fortran_order": False, "shape": shape}
        npy.write_array_header_1_0(file, header)
        parts: list[Columns] = []
        for frames, columns in content:
            file.write(np.ascontiguousarray(frames).data)
            parts.append(columns)
        joined = joined_columns(parts)
        file.write(bytes(-file.tell() % _ALIGNMENT))
        for array in joined.values():
            npy.write_array(file, array, (1, 0))
            file.write(bytes(-file.tell() % _ALIGNMENT))
        file.write(_digest(key, shape, joined))
        file.flush()
        # Otherwise, after a power failure, the name could be there without the content.
        os.fsync(file.fileno())


def _make_room(path: Path, most: int) -> None:
    """Remove the least recently used cache files beside a path until `most` bytes are left."""
    others = [each for each in path.parent.iterdir() if _NAME.fullmatch(each.name) and each != path]
    states = sorted(((each.stat(), each) for each in others), key=lambda pair: pair[0].st_mtime)
    total = sum(state.st_size for state, _ in states)
    for state, each in states:
        if total > most and _is_cache(each):
            each.unlink(missing_ok=True)
            total -= state.st_size


def _remove_leftovers(folder: Path) -> None:
    """Remove what killed processes have left: files whose lock no process holds."""
    for lock in folder.glob(f".*{SUFFIX}.lock"):
        with suppress(OSError), locked(lock, wait=False):
            for left in temporaries(folder / lock.name[1 : -len(".lock")]):
                left.unlink(missing_ok=True)

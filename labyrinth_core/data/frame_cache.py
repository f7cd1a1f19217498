"""Transitions in a file that is mapped into memory, so that pictures are decoded only once.

A cache file is the array `frames` in the format .npy (`numpy.load` reads it), the other fields of
`Transitions` in the same format, and a trailer: the numbers of frames and transitions, and the
SHA-256 of key, numbers and all that is not frames. So the layout follows from the trailer, and a
file that is cut short, or of another key, is told apart and made again. The frames themselves are
not hashed when a file is opened: that would be to read them all.

A file is written under another name and renamed when it is whole. Whoever writes holds a lock on
it, which the kernel takes back from the dead; others wait, and then find the file.
"""

from __future__ import annotations

import hashlib
import io
import os
import struct
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.data.locks import lock, locked
from labyrinth_core.data.transitions import LoadedEpisode, Transitions, gather

COLUMNS: dict[str, np.dtype[Any]] = {
    "rows": np.dtype("<i8"),
    "actions": np.dtype("<i8"),
    "rewards": np.dtype("<f4"),
    "dones": np.dtype("?"),
    "labyrinth_ids": np.dtype("<i8"),
}
"""The fields of `Transitions` that follow the frames, in order."""

SUFFIX = ".frames.npy"
"""What the names of cache files end with, so that leftovers are known from files of others."""

_NUMBERS = struct.Struct("<QQ")
_TRAILER = struct.Struct("<QQ32s")
_ALIGNMENT = 64


def user_folder() -> Path:
    """Return where caches lie by default (XDG Base Directory Specification, version 0.8).

    Raises:
        OSError: Nobody knows where the home of the user is.
    """
    base = Path(os.environ.get("XDG_CACHE_HOME", ""))
    if not base.is_absolute():  # "The path is relative": to be ignored.
        try:
            base = Path.home() / ".cache"
        except RuntimeError as error:
            raise OSError(str(error)) from error
    return base / "labyrinth-datasets"


def load(
    path: Path, key: str, image_size: int, episodes: Callable[[], Iterable[LoadedEpisode]]
) -> Transitions:
    """Return the transitions of a cache file, which is made if it is not there or not right.

    Args:
        path: The file.
        key: All that its content depends on.
        image_size: Pixels on each side of the frames.
        episodes: What is asked for the episodes, if the file has to be made.

    Raises:
        OSError: The file can be neither read nor made.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    found = read(path, key, image_size)
    if found is not None:
        return found
    _remove_leftovers(path.parent)
    temporary = path.with_name(f".{path.name}.tmp")
    with locked(temporary) as file:
        try:
            found = read(path, key, image_size)
            if found is None:
                _write(file, key, image_size, episodes())
                temporary.replace(path)
            else:
                temporary.unlink()
        except BaseException:
            temporary.unlink(missing_ok=True)
            raise
    if found is None:
        found = read(path, key, image_size)
    if found is None:
        raise OSError(f"{path} was made, but is not what was written")
    return found


def read(path: Path, key: str, image_size: int) -> Transitions | None:
    """Return the transitions of a cache file, None if it is not there, or not whole, or another's.

    Raises:
        OSError: The file cannot be read.
    """
    try:
        mapped = np.asarray(np.memmap(path, np.uint8, "r"))
    except (FileNotFoundError, ValueError):  # The latter for an empty file.
        return None
    size = len(mapped)
    if size < _TRAILER.size:
        return None
    frames, count, digest = _TRAILER.unpack(mapped[-_TRAILER.size :].tobytes())
    parts, end = _layout(frames, count, image_size)
    if end + _TRAILER.size != size:
        return None
    columns = mapped[parts["rows"].header_at : end]
    if _digest(key, frames, count, columns.data) != digest:
        return None
    head = parts["frames"]
    if mapped[: len(head.header)].tobytes() != head.header:
        return None
    return Transitions(**{name: part.of(mapped) for name, part in parts.items()})


class _Part(NamedTuple):
    """Where an array lies in the file."""

    header_at: int
    header: bytes
    shape: tuple[int, ...]
    dtype: np.dtype[Any]

    @property
    def begin(self) -> int:
        return self.header_at + len(self.header)

    @property
    def end(self) -> int:
        count = 1
        for length in self.shape:  # Not by numpy, whose numbers overflow.
            count *= length
        return self.begin + count * self.dtype.itemsize

    def of(self, mapped: NDArray[np.uint8]) -> NDArray[Any]:
        return mapped[self.begin : self.end].view(self.dtype).reshape(self.shape)


def _layout(frames: int, count: int, image_size: int) -> tuple[dict[str, _Part], int]:
    """Return where each array lies, and where the last ends; each begins at a multiple of 64."""
    parts = {}
    at = 0
    shapes: dict[str, tuple[tuple[int, ...], np.dtype[Any]]] = {
        "frames": ((frames, image_size, image_size, 3), np.dtype("u1"))
    }
    shapes |= {name: ((count,), dtype) for name, dtype in COLUMNS.items()}
    for name, (shape, dtype) in shapes.items():
        parts[name] = part = _Part(at, _header(shape, dtype), shape, dtype)
        at = -(-part.end // _ALIGNMENT) * _ALIGNMENT
    return parts, at


def _header(shape: tuple[int, ...], dtype: np.dtype[Any]) -> bytes:
    """Return what an .npy file begins with, of the same length for any number of items."""
    header = io.BytesIO()
    description = np.lib.format.dtype_to_descr(dtype)
    fields = {"descr": description, "fortran_order": False, "shape": shape}
    np.lib.format.write_array_header_1_0(header, fields)
    return header.getvalue()


def _digest(key: str, frames: int, count: int, columns: memoryview) -> bytes:
    digest = hashlib.sha256(f"{len(key)}:{key}".encode() + _NUMBERS.pack(frames, count))
    digest.update(columns)
    return digest.digest()


def _write(file: BinaryIO, key: str, image_size: int, episodes: Iterable[LoadedEpisode]) -> None:
    """Write a cache file, which is on the disk when this returns."""
    file.truncate(0)
    file.write(_layout(0, 0, image_size)[0]["frames"].header)
    frames = 0

    def keep(observations: NDArray[Any]) -> None:
        nonlocal frames
        file.write(np.ascontiguousarray(observations).data)
        frames += len(observations)

    arrays = gather(episodes, keep)
    count = len(arrays["rows"])
    parts, end = _layout(frames, count, image_size)
    columns = memoryview(bytearray(end - parts["rows"].header_at))
    for name, dtype in COLUMNS.items():
        at = parts[name].header_at - parts["rows"].header_at
        content = parts[name].header + arrays[name].astype(dtype).tobytes()
        columns[at : at + len(content)] = content
    file.write(bytes(parts["rows"].header_at - parts["frames"].end))
    file.write(columns)
    file.write(_TRAILER.pack(frames, count, _digest(key, frames, count, columns)))
    file.seek(0)
    file.write(parts["frames"].header)
    file.flush()
    # Or a machine that goes out could keep the name, and not what is in the file.
    os.fsync(file.fileno())


def _remove_leftovers(folder: Path) -> None:
    """Remove what processes that were killed have left: files that nobody holds a lock on."""
    for path in folder.glob(f".*{SUFFIX}.tmp"):
        try:
            with path.open("r+b") as file:
                lock(file, wait=False)
                path.unlink()
        except OSError:  # Somebody holds it, or it is gone already.
            continue

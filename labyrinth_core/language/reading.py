"""Files of others as bytes: regular files, of a limited size, from archives that may be damaged."""

from __future__ import annotations

import errno
import zipfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, BinaryIO, TypeVar

AnyPath = TypeVar("AnyPath")


def regular_file(path: AnyPath) -> AnyPath:
    """Return the path of a file that is to be read; one of an object store as it is.

    Raises:
        OSError: A pipe or a device is there, from which bytes may come for ever, or never.
    """
    if isinstance(path, Path) and path.exists() and not (path.is_file() or path.is_dir()):
        raise OSError(errno.EINVAL, "is a pipe or a device, not a regular file", str(path))
    return path


def read_at_most(open_file: Callable[[], Any], max_bytes: int) -> bytes:
    """Return the bytes of a file, of which no more are read or unpacked than are allowed.

    Raises:
        ValueError: It has more.
    """
    with open_file() as stream:
        data: bytes = stream.read(max_bytes + 1)
    if len(data) > max_bytes:
        raise ValueError(f"it has more than {max_bytes:,} bytes")
    return data


def open_archive(file: Path | BinaryIO) -> zipfile.ZipFile:
    """Return the zip archive in a file; raise ValueError if it holds none."""
    try:
        return zipfile.ZipFile(file)
    except (zipfile.BadZipFile, OSError, ValueError, NotImplementedError) as error:
        raise ValueError(f"no zip archive that can be read: {error}") from error


def unpack(archive: zipfile.ZipFile, name: str, max_bytes: int) -> bytes:
    """Return the bytes of a file in an archive.

    Raises:
        ValueError: It is not there, it is damaged, or it has more bytes than are allowed.
    """
    try:
        return read_at_most(partial(archive.open, name), max_bytes)
    except (ValueError, MemoryError):
        raise
    except Exception as error:  # Each compression has its own errors; LZMA may not be installed.
        raise ValueError(f"it cannot be unpacked: {error}") from error

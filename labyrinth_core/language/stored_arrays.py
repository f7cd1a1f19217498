"""Arrays and texts in files of strangers: read as data, with limits, and never unpickled."""

from __future__ import annotations

import io
import zipfile
import zlib
from tokenize import TokenError
from typing import Any

import numpy as np
from numpy.typing import NDArray

MAX_BYTES = 1 << 28
"""The largest size of a file, and of what is unpacked from an archive."""


def read_array(data: bytes) -> NDArray[Any]:
    """Return the booleans or numbers in the bytes of a .npy file.

    Raises:
        ValueError: They are no such file.
    """
    try:
        array: NDArray[Any] = np.lib.format.read_array(io.BytesIO(data), allow_pickle=False)
    except (ValueError, OSError, EOFError, MemoryError, SyntaxError, TokenError) as error:
        # Its header may claim anything; numpy parses it as the text of a literal.
        raise ValueError(f"no array that can be read: {error}") from error
    if array.dtype.kind not in "biuf":
        raise ValueError(f"expected an array of booleans or numbers, found {array.dtype}")
    return array


def open_archive(data: bytes) -> zipfile.ZipFile:
    """Return the archive in the bytes of a zip file, such as .npz.

    Raises:
        ValueError: They are no zip file.
    """
    try:
        return zipfile.ZipFile(io.BytesIO(data))
    except (zipfile.BadZipFile, OSError, ValueError, NotImplementedError) as error:
        raise ValueError(f"no zip archive that can be read: {error}") from error


def read_member(archive: zipfile.ZipFile, name: str) -> bytes:
    """Return the bytes of a file in an archive, of which no more is unpacked than may be.

    Raises:
        ValueError: It is missing, damaged, encrypted or too large.
    """
    try:
        with archive.open(name) as stream:
            data = stream.read(MAX_BYTES + 1)
    except (
        KeyError,
        OSError,
        EOFError,
        RuntimeError,  # It is encrypted, or compressed in a way that is not known.
        zipfile.BadZipFile,
        zlib.error,
    ) as error:
        raise ValueError(f"it cannot be unpacked: {error}") from error
    return limited(data)


def limited(data: bytes) -> bytes:
    """Return bytes that are not too many.

    Raises:
        ValueError: They are.
    """
    if len(data) > MAX_BYTES:
        raise ValueError(f"it has more than {MAX_BYTES:,} bytes")
    return data

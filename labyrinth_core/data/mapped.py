"""Memory-mapped arrays, which are sent to other processes as file name and offset."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.data.errors import DatasetError


class MappedArray(NamedTuple):
    """The place of an array in a file."""

    path: str
    offset: int
    """The offset in bytes."""
    shape: tuple[int, ...]
    dtype: str


def as_sent(array: NDArray[Any]) -> NDArray[Any] | MappedArray:
    """Return the place of an array if it is mapped from a file, else the array itself."""
    mapped: Any = array
    while mapped is not None and not isinstance(mapped, np.memmap):
        mapped = getattr(mapped, "base", None)
    # A writable array has to be copied, so that the other process does not write to the file.
    if mapped is None or mapped.mode != "r" or mapped.filename is None:
        return array
    if not array.flags.c_contiguous:
        return array
    offset = mapped.offset + array.ctypes.data - mapped.ctypes.data
    return MappedArray(str(mapped.filename), offset, array.shape, array.dtype.str)


def as_received(sent: NDArray[Any] | MappedArray) -> NDArray[Any]:
    """Return the array that `as_sent` described.

    Raises:
        DatasetError: The file is gone or has become shorter.
    """
    if not isinstance(sent, MappedArray):
        return sent
    try:
        mapped = np.memmap(sent.path, sent.dtype, "r", sent.offset, sent.shape)
    except (OSError, ValueError) as error:
        raise DatasetError(f"{sent.path} is gone since it was loaded: {error}") from error
    return np.asarray(mapped)

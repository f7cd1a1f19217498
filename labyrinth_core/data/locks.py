"""Files that one process holds at a time; a process that ends, however, holds none."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO


def locked(path: Path, before_waiting: Callable[[], None] = lambda: None) -> BinaryIO:
    """Return a file, opened for writing, that nobody else has; wait for it if need be.

    Args:
        path: The file, which is made if need be. It is given back by closing it; whoever removes
            or renames it does so before.
        before_waiting: Called if somebody else has it.

    Raises:
        OSError: The file cannot be opened, or the system has no such locks.
    """
    while True:
        file = os.fdopen(os.open(path, os.O_RDWR | os.O_CREAT, 0o666), "r+b")
        try:
            try:
                lock(file, wait=False)
            except BlockingIOError:
                before_waiting()
                lock(file)
            # Meanwhile it may have been finished and renamed, or removed.
            if os.path.samestat(os.fstat(file.fileno()), path.stat()):
                return file
        except FileNotFoundError:
            pass
        except BaseException:
            file.close()
            raise
        file.close()


def lock(file: BinaryIO, *, wait: bool = True) -> None:
    """Take the lock of a file; raise BlockingIOError if somebody has it and `wait` is false."""
    if sys.platform == "win32":
        raise OSError("this system has no flock")
    import fcntl

    fcntl.flock(file, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))

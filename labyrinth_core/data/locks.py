"""Advisory file locks, which the system releases when their process dies."""

from __future__ import annotations

import errno
import os
import re
import socket
import stat
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

_HOLDER = re.compile(rb"(process \d+ on .+)?")
"""The content of the two files of a lock."""


@contextmanager
def locked(
    path: Path, before_waiting: Callable[[str], None] = lambda _: None, *, wait: bool = True
) -> Iterator[None]:
    """Hold the lock of a file, which is made if need be and removed at the end.

    Args:
        path: The file; only this function may make, remove or rename it. Beside it, with
            the suffix `.holder`, lies a file that says which process has the lock, since
            on Windows no process can read a locked file.
        before_waiting: Called with the holder, such as `process 1 on host`, if there is one.
        wait: Whether to wait for another holder.

    Raises:
        TimeoutError: Another process has the lock, and `wait` is false.
        OSError: The file cannot be made, or its file system has no locks.
        FileExistsError: A file that is not of a lock is there.
    """
    from filelock import FileLock, Timeout

    lock = FileLock(path, fallback_to_soft=False)
    holder = path.with_name(f"{path.name}.holder")
    _refuse_others(path)
    _refuse_others(holder)
    try:
        lock.acquire(blocking=False)
    except Timeout:
        if not wait:
            raise
        name = "another process"
        with suppress(OSError):  # The file may have been removed just now.
            name = holder.read_text(encoding="utf-8", errors="replace") or name
        before_waiting(name)
        lock.acquire()
    try:
        holder.write_text(f"process {os.getpid()} on {socket.gethostname()}", encoding="utf-8")
        yield
    finally:
        # Removed while locked: `filelock` checks after locking that the file still has a name.
        # On Windows, where a locked file cannot be removed, `release` removes it.
        for each in (holder, path):
            with suppress(OSError):
                each.unlink()
        lock.release()


def _refuse_others(path: Path) -> None:
    """Raise FileExistsError if something is at a path that `locked` has not left there."""
    with suppress(FileNotFoundError):
        found = path.lstat()
        # The file of a lock is empty; on Windows no process can read a locked one.
        content = path.read_bytes() if stat.S_ISREG(found.st_mode) and found.st_size else b""
        if not stat.S_ISREG(found.st_mode) or not _HOLDER.fullmatch(content):
            raise FileExistsError(errno.EEXIST, "is not a lock: move it away", str(path))

"""Advisory file locks, which the system releases when their process dies."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path


@contextmanager
def locked(
    path: Path, before_waiting: Callable[[], None] = lambda: None, *, wait: bool = True
) -> Iterator[None]:
    """Hold the lock of a file, which is made if need be and removed at the end.

    Args:
        path: The file; only this function may make, remove or rename it.
        before_waiting: Called if another process has the lock.
        wait: Whether to wait for another process.

    Raises:
        TimeoutError: Another process has the lock, and `wait` is false.
        OSError: The file cannot be made, or its file system has no locks.
    """
    from filelock import FileLock, Timeout

    lock = FileLock(path, fallback_to_soft=False)
    try:
        lock.acquire(blocking=False)
    except Timeout:
        if not wait:
            raise
        before_waiting()
        lock.acquire()
    try:
        yield
    finally:
        # Removed while locked: `filelock` checks after locking that the file still has a name.
        # On Windows, where a locked file cannot be removed, `release` removes it.
        with suppress(OSError):
            path.unlink()
        lock.release()

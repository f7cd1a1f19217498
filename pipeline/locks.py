"""Files that one process holds at a time; a process that ends, however, holds none."""

from __future__ import annotations

import os
import socket
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from pipeline.storage import AnyPath, RemotePath


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


@contextmanager
def held(folder: AnyPath, name: str) -> Iterator[None]:
    """Be the only process that changes something in a folder; wait for another, and say which.

    An object store has no locks, nor have some file systems; there nobody waits.

    Args:
        folder: Made if need be, and removed again if it is empty at the end.
        name: Of what is changed; what `storage.write_bytes` left of it unfinished is removed.
    """
    if isinstance(folder, RemotePath):
        yield
        return
    path = folder / f".{name}.lock"
    made = [each for each in [folder, *folder.parents] if not each.exists()]

    def say_who() -> None:
        from pipeline.terminal import console

        holder = path.read_text(encoding="utf-8", errors="replace") or "another process"
        console.print(f"waiting for {holder}, which works on {folder / name}", highlight=False)

    with ExitStack() as stack:
        for each in reversed(made):  # Callbacks are called last one first.
            stack.callback(_remove_if_empty, each)
        with suppress(OSError):  # Whoever cannot make a file here will soon say so.
            folder.mkdir(parents=True, exist_ok=True)
            file = stack.enter_context(locked(path, say_who))
            stack.callback(path.unlink, missing_ok=True)
            for left in folder.glob(f".{name}.*.tmp"):  # By one that was killed while it wrote.
                left.unlink()
            file.truncate(0)
            os.write(file.fileno(), f"process {os.getpid()} on {socket.gethostname()}".encode())
        yield


def _remove_if_empty(folder: Path) -> None:
    with suppress(OSError):
        folder.rmdir()

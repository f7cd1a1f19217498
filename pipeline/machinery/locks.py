"""Folders in which one process at a time changes something."""

from __future__ import annotations

import os
import socket
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from labyrinth_core.data.locks import locked
from labyrinth_core.data.storage import AnyPath, RemotePath


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
        from pipeline.machinery.console import console

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

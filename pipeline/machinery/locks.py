"""Locks on folders, so that one process at a time changes them."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from labyrinth_core.data.locks import locked
from labyrinth_core.data.storage import AnyPath, RemotePath
from pipeline.machinery.console import console


@contextmanager
def held(folder: AnyPath, name: str) -> Iterator[None]:
    """Hold the lock of a file or folder in a folder; wait for another process, and say which.

    Object stores and some file systems have no locks; there nobody waits.

    Args:
        folder: The folder, which is made if need be, and removed if it is empty at the end.
        name: The name of what is changed; unfinished files of `storage.write_bytes` are removed.
    """
    if isinstance(folder, RemotePath):
        yield
        return

    def say_who(holder: str) -> None:
        console.print(f"waiting for {holder}, which works on {folder / name}", highlight=False)

    with ExitStack() as stack:
        # Callbacks are called last one first: the innermost folder is removed before the others.
        for each in [*reversed(folder.parents), folder]:
            if not each.exists():
                stack.callback(_remove_if_empty, each)
        with suppress(OSError):  # A folder that cannot be written is reported by the caller.
            folder.mkdir(parents=True, exist_ok=True)
            stack.enter_context(locked(folder / f".{name}.lock", say_who))
            for left in folder.glob(f".{name}.*.tmp"):  # Left by a process that was killed.
                left.unlink()
        yield


def _remove_if_empty(folder: Path) -> None:
    with suppress(OSError):
        folder.rmdir()

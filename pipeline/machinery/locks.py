"""Folders in which one process at a time changes something."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from labyrinth_core.data.locks import locked
from labyrinth_core.data.storage import AnyPath, RemotePath
from pipeline.machinery.console import console


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

    def say_who(holder: str) -> None:
        console.print(f"waiting for {holder}, which works on {folder / name}", highlight=False)

    with ExitStack() as stack:
        # Callbacks are called last one first: the innermost folder is removed before the others.
        for each in [*reversed(folder.parents), folder]:
            if not each.exists():
                stack.callback(_remove_if_empty, each)
        with suppress(OSError):  # Whoever cannot make a file here will soon say so.
            folder.mkdir(parents=True, exist_ok=True)
            stack.enter_context(locked(folder / f".{name}.lock", say_who))
            for left in folder.glob(f".{name}.*.tmp"):  # By one that was killed while it wrote.
                left.unlink()
        yield


def _remove_if_empty(folder: Path) -> None:
    with suppress(OSError):
        folder.rmdir()

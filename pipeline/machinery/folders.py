"""Folders that one process at a time changes, and that appear whole."""

from __future__ import annotations

import os
import shutil
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from labyrinth_core.data.locks import locked
from labyrinth_core.data.storage import AnyPath, RemotePath
from pipeline.machinery.console import console


@contextmanager
def held(folder: AnyPath, name: str) -> Iterator[None]:
    """Hold the lock of a file or folder in a folder; wait for another process, and name it.

    Object stores and some file systems have no locks: there the context begins at once.

    Args:
        folder: The folder, which is made if it does not exist, and removed if it is empty at the
            end.
        name: The name of what is changed; unfinished files of `storage.write_bytes` are removed.
    """
    if isinstance(folder, RemotePath):
        yield
        return

    def say_who(holder: str) -> None:
        console.print(f"waiting for {holder}, which works on {folder / name}", highlight=False)

    with ExitStack() as stack:
        # The last callback is called first: the innermost folder is removed before the others.
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


def wait_for_disk(folder: Path) -> None:
    """Wait until a folder and all of its content would survive a power failure."""
    for path in [*folder.rglob("*"), folder]:
        _wait(path)


def move_into_place(made: Path, folder: Path) -> None:
    """Move a folder to its place, and replace a folder that is there.

    After a crash on the way, `recover` puts the replaced folder back.
    """
    replaced = _replaced(folder)
    if folder.exists():
        _remove(replaced)
        folder.replace(replaced)
    made.replace(folder)
    _remove(replaced)
    _wait(folder.parent)


def recover(folder: Path) -> None:
    """Put a folder back that a crash in `move_into_place` displaced."""
    replaced = _replaced(folder)
    if replaced.exists() and not folder.exists():
        replaced.replace(folder)
    _remove(replaced)


def _wait(path: Path) -> None:
    if sys.platform == "win32":
        return  # Folders cannot be opened there.
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    except OSError:
        if not path.is_dir():  # Some file systems cannot sync folders.
            raise
    finally:
        os.close(descriptor)


def _replaced(folder: Path) -> Path:
    return folder.with_name(f".{folder.name}.replaced")


def _remove(folder: Path) -> None:
    """Remove a folder, or a link that a user put in its place."""
    if folder.is_symlink():
        folder.unlink()
    else:
        shutil.rmtree(folder, ignore_errors=True)

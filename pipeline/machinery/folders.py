"""Locks on folders, folders that are not links, and files made elsewhere and moved in place."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import TypeVar

from labyrinth_core.errors import DatasetError
from labyrinth_core.storage import (
    AnyPath,
    File,
    LocalFile,
    RemotePath,
)
from pipeline.machinery.console import say

Place = TypeVar("Place", Path, AnyPath)


@contextmanager
def new_file(path: AnyPath, scratch: AnyPath) -> Iterator[Path]:
    """Yield a temporary local path to write; the file is then moved or uploaded to `path`.

    The temporary path is absolute, because Arrow takes a relative one with a colon for a URL.

    Args:
        path: The final place of the file, where it appears complete or not at all.
        scratch: The folder of the temporary file, on the same disk as a local path. After a kill
            it is one of the `temporaries` there. A process that was given up may still write there
            while another makes the same file.

    Raises:
        OSError: The file cannot be written, or a folder or a device is there.
    """
    if isinstance(path, RemotePath):
        with tempfile.TemporaryDirectory(prefix="labyrinth-") as folder:
            local = Path(folder) / path.name
            with LocalFile(local).naming():
                yield local
            path.upload(local)
        return
    local = LocalFile(Path(str(scratch)).absolute() / path.name).temporary()
    try:
        with LocalFile(path).naming(local):
            yield local
            local.replace(LocalFile(path).replaceable())
    finally:
        local.unlink(missing_ok=True)


@contextmanager
def held(folder: AnyPath, name: str) -> Iterator[bool]:
    """Hold the lock of `folder / name`; if another process holds it, say so and wait.

    Object stores and some file systems have no locks: there the context begins at once. The
    context gives whether the lock is held, so that what other processes left there is of dead ones.

    Args:
        folder: The folder, created if it does not exist; then removed if it is empty at the end.
        name: The file or folder to change. Temporary files of it, from killed processes, are
            removed.

    Raises:
        DatasetError: A file is in the place of the folder.
    """
    if isinstance(folder, RemotePath):
        yield False
        return

    def say_so() -> None:
        say(f"waiting for another process that works on {folder / name}")

    with ExitStack() as stack:
        # Callbacks run last to first, so the innermost folder is removed before the others.
        for each in [*reversed(folder.parents), folder]:
            if not each.exists():
                stack.callback(_remove_if_empty, each)
        with suppress(OSError):  # A folder that cannot be written is reported by the caller.
            folder.mkdir(parents=True, exist_ok=True)
        if file := next((each for each in [folder, *folder.parents] if each.is_file()), None):
            raise DatasetError(f"{file} is a file: move it, or choose another folder")
        is_locked = False
        try:
            stack.enter_context(LocalFile(folder / f".{name}.lock").locked(say_so))
            is_locked = True
            for left in LocalFile.temporaries(folder, [name]):
                File(left).remove()
        except OSError:  # Reported by the caller, or the file system has no locks.
            pass
        yield is_locked


def _remove_if_empty(folder: Path) -> None:
    with suppress(OSError):
        folder.rmdir()


def within(folder: Place, *names: str) -> Place:
    """Return a folder inside a folder of ours, for files to be written to or removed from.

    Args:
        folder: The folder of ours, which may be a link.
        names: The names of the folders on the way, and of the folder itself.

    Raises:
        DatasetError: One of them is a link: what is behind it is not ours.
    """
    for name in names:
        folder = folder / name
        if folder.is_symlink():
            reason = "is a link, and nothing is written through it"
            raise DatasetError(f"{folder} {reason}: put a folder in its place, or remove it")
    return folder

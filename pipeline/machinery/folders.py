"""Folders that one process at a time changes, and that appear whole."""

from __future__ import annotations

import errno
import os
import shutil
import sys
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from labyrinth_core.data.storage import (
    AnyPath,
    RemotePath,
    file_at,
    locked,
    naming,
    replacing,
    temporaries,
    temporary_beside,
)
from pipeline.machinery.console import say

_REPLACED = ".replaced"
"""The end of the name of a folder that another takes the place of."""

_COMPLETE = ".complete"
"""The end of the name of a folder whose files are copied to a place that cannot be renamed. The
folder is complete once it has its mark."""

_NOT_RENAMED = (errno.EXDEV, errno.EBUSY)
"""The errors of a folder in a lower layer of a container's file system, and of a mount point."""


@contextmanager
def new_file(path: AnyPath, scratch: AnyPath) -> Iterator[Path]:
    """Lend the name of a local file to be made, which is then moved or uploaded to a path.

    The name is absolute, as Arrow takes a relative one with a colon for a URL.

    Args:
        path: The final place of the file, where it appears whole or not at all.
        scratch: Folder for the temporary file, on the same disk as a local path. A process that
            was given up may still write there while another makes the same file.

    Raises:
        OSError: The file cannot be written, or something that is not a regular file is there.
    """
    target = file_at(path) if isinstance(path, Path) else path
    if target != path:  # A link may lead to another disk.
        scratch = target.parent
    place = scratch.absolute() if isinstance(scratch, Path) else None
    with tempfile.TemporaryDirectory(prefix=".labyrinth-", dir=place) as folder:
        local = Path(folder) / path.name
        with naming(target if isinstance(target, Path) else local):
            yield local
        if isinstance(target, Path):
            local.replace(target)
        else:
            target.upload(local)


@contextmanager
def held(folder: AnyPath, name: str) -> Iterator[None]:
    """Hold the lock of a file or folder in a folder; wait for another process, and say so.

    Object stores and some file systems have no locks: there the context begins at once.

    Args:
        folder: The folder, which is made if it does not exist, and removed if it is empty at the
            end.
        name: The name of what is changed; what killed processes left unfinished is removed.
    """
    if isinstance(folder, RemotePath):
        yield
        return

    def say_so() -> None:
        say(f"waiting for another process that works on {folder / name}")

    with ExitStack() as stack:
        # The last callback is called first: the innermost folder is removed before the others.
        for each in [*reversed(folder.parents), folder]:
            if not each.exists():
                stack.callback(_remove_if_empty, each)
        with suppress(OSError):  # A folder that cannot be written is reported by the caller.
            folder.mkdir(parents=True, exist_ok=True)
        try:
            stack.enter_context(locked(folder / f".{name}.lock", say_so))
            for left in temporaries(folder / name):
                remove(left)
        except OSError:  # Likewise; or there are no locks.
            pass
        yield


def _remove_if_empty(folder: Path) -> None:
    with suppress(OSError):
        folder.rmdir()


def followed(folder: Path) -> Path:
    """Return the folder to which a link leads, so that it is replaced and the link stays."""
    return Path(os.path.realpath(folder)) if folder.is_symlink() else folder


def wait_for_disk(folder: Path) -> None:
    """Wait until a folder and all of its content would survive a power failure."""
    for path in [*folder.rglob("*"), folder]:
        if not path.is_symlink():  # It may lead nowhere.
            _wait(path)


def move_into_place(made: Path, folder: Path, mark: str) -> None:
    """Move a folder to its place once it would survive a power failure; remove one that is there.

    Where a folder cannot be renamed, its files are copied, the mark last. After a crash on the way,
    `recover` puts the replaced folder back or goes on copying.

    Args:
        made: The new folder, beside its place or deeper, on the same disk.
        folder: Its place.
        mark: The name of the file without which readers take the folder for unfinished.
    """
    wait_for_disk(made)
    try:
        if folder.exists():
            folder.replace(temporary_beside(folder, _REPLACED))
        made.replace(folder)
    except OSError as error:
        if error.errno not in _NOT_RENAMED:
            raise
        complete = temporary_beside(folder, _COMPLETE)
        for file in _files(made, mark):
            place = complete / file.relative_to(made)
            place.parent.mkdir(parents=True, exist_ok=True)
            file.replace(place)
        remove(made)
    recover(folder, mark)
    _wait(folder.parent)


def recover(folder: Path, mark: str) -> None:
    """Complete a folder that a crash in `move_into_place` left, or put the replaced one back."""
    for complete in temporaries(folder, _COMPLETE):
        if (complete / mark).exists():
            _copy(complete, folder, mark)
        remove(complete)
    for replaced in temporaries(folder, _REPLACED):
        if folder.exists():
            remove(replaced)
        else:
            replaced.replace(folder)


def _copy(complete: Path, folder: Path, mark: str) -> None:
    """Copy a folder's files in place of what is in another, which has its mark only at the end."""
    folder.mkdir(exist_ok=True)
    for old in sorted(folder.iterdir(), key=lambda path: path.name != mark):
        remove(old)
    for file in _files(complete, mark):
        if file == complete / mark:
            wait_for_disk(folder)
        place = folder / file.relative_to(complete)
        place.parent.mkdir(parents=True, exist_ok=True)
        with replacing(place) as temporary:
            shutil.copy2(file, temporary, follow_symlinks=False)
    wait_for_disk(folder)


def _files(folder: Path, mark: str) -> list[Path]:
    """Return the files of a folder at any depth, its mark last."""
    files = (path for path in folder.rglob("*") if path.is_symlink() or not path.is_dir())
    return sorted(files, key=lambda path: path == folder / mark)


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


def remove(path: AnyPath) -> None:
    """Remove a file, or a local folder with its content, in which a process may still write."""
    if isinstance(path, Path) and path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
    else:
        path.unlink(missing_ok=True)

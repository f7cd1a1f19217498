"""Locks on folders, and files and folders that appear complete or not at all."""

from __future__ import annotations

import errno
import os
import shutil
import sys
import tempfile
from collections.abc import Collection, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar, TypeVar

from labyrinth_core.errors import DatasetError
from labyrinth_core.storage import (
    AnyPath,
    File,
    LocalFile,
    RemotePath,
)
from pipeline.machinery.console import say

_REPLACED = ".replaced"
"""The suffix of a folder that another folder replaces."""

_COMPLETE = ".complete"
"""The suffix of a folder whose files are copied to a place that cannot be renamed. The folder is
complete once it has its mark."""

Place = TypeVar("Place", Path, AnyPath)

_NOT_RENAMED = (errno.EXDEV, errno.EBUSY)
"""The errors of renaming a folder in a lower layer of a container, or a mount point."""


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
                remove(left)
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


@dataclass(frozen=True)
class Renamed:
    """A local folder that is made under another name, and renamed into its place when complete.

    Until then, the folder that it replaces stays.
    """

    folder: Path
    """Its place; of a link to a folder, the target, which is replaced instead of the link."""
    mark: str
    """The file whose absence tells readers that the folder is unfinished."""
    is_replaced_at_once: ClassVar[bool] = True

    def making(self, beside: AnyPath) -> AnyPath:
        """Return the folder to make files in: one that the caller offers, on the same disk."""
        return beside

    def recover(self) -> None:
        """Finish or undo what a crash in `complete` has left."""
        recover(self.folder, self.mark)

    def complete(self, made: Any) -> None:
        """Put the folder that was made in its place; see `move_into_place`."""
        move_into_place(made, self.folder, self.mark)

    def leftovers(self, folder: Any, names: Collection[str]) -> list[Path]:
        """Return what killed processes left of files with these names in a folder."""
        return LocalFile.temporaries(folder, names)

    def is_covered(self, changed: float) -> bool:  # noqa: ARG002
        """Return False: a file that counts as complete is hashed."""
        return False


@dataclass(frozen=True)
class Marked:
    """A folder in an object store, where nothing is renamed: it is complete once it has its mark.

    Each file appears complete under its own name.
    """

    folder: RemotePath
    mark: str
    """The file that is removed first and written last."""
    is_replaced_at_once: ClassVar[bool] = False

    def making(self, beside: AnyPath) -> AnyPath:  # noqa: ARG002
        """Return the folder itself."""
        return self.folder

    def recover(self) -> None:
        """Do nothing: without its mark the folder is unfinished."""

    def complete(self, made: Any) -> None:
        """Do nothing: the caller has written the mark into the folder."""

    def leftovers(self, folder: Any, names: Collection[str]) -> list[Path]:  # noqa: ARG002
        """Return nothing: an upload leaves no unfinished file."""
        return []

    def is_covered(self, changed: float) -> bool:
        """Return whether a file that changed at this time is older than the mark.

        It was complete then. To hash it would mean to download it.
        """
        return changed < self._marked

    @cached_property
    def _marked(self) -> float:
        return File(self.folder / self.mark).size_and_time()[1]


Completion = Renamed | Marked


def completion(folder: AnyPath, mark: str) -> Completion:
    """Return how a folder becomes complete in its place."""
    if isinstance(folder, RemotePath):
        return Marked(folder, mark)
    return Renamed(followed(folder), mark)


def followed(folder: Path) -> Path:
    """Return the target of a link to a folder, so that the target is replaced and not the link."""
    return Path(os.path.realpath(folder)) if folder.is_symlink() else folder


def wait_for_disk(folder: Path) -> None:
    """Sync a folder and all its content to disk, so that they survive a power failure."""
    for path in [*folder.rglob("*"), folder]:
        if not path.is_symlink():  # It may be broken.
            _wait(path)


def move_into_place(made: Path, folder: Path, mark: str) -> None:
    """Sync a folder to disk and move it to its place, in place of the folder that is there.

    If a folder cannot be renamed, its files are copied, the mark last. After a crash on the way,
    `recover` puts the replaced folder back or finishes copying.

    Args:
        made: The new folder, beside its place or deeper, on the same disk.
        folder: Its place.
        mark: The name of the file whose absence tells readers that the folder is unfinished.
    """
    wait_for_disk(made)
    try:
        if folder.exists():
            folder.replace(LocalFile(folder).temporary(_REPLACED))
        made.replace(folder)
    except OSError as error:
        if error.errno not in _NOT_RENAMED:
            raise
        complete = LocalFile(folder).temporary(_COMPLETE)
        for file in _files(made, mark):
            place = complete / file.relative_to(made)
            place.parent.mkdir(parents=True, exist_ok=True)
            file.replace(place)
        remove(made)
    recover(folder, mark)
    _wait(folder.parent)


def recover(folder: Path, mark: str) -> None:
    """Complete a folder that a crash in `move_into_place` left, or put the replaced one back."""
    for complete in LocalFile.temporaries(folder.parent, [folder.name], _COMPLETE):
        if (complete / mark).exists():
            _copy(complete, folder, mark)
        remove(complete)
    for replaced in LocalFile.temporaries(folder.parent, [folder.name], _REPLACED):
        if folder.exists():
            remove(replaced)
        else:
            replaced.replace(folder)


def _copy(complete: Path, folder: Path, mark: str) -> None:
    """Replace a folder's content with the files of another folder, the mark last."""
    folder.mkdir(exist_ok=True)
    for old in sorted(folder.iterdir(), key=lambda path: path.name != mark):
        remove(old)
    for file in _files(complete, mark):
        if file == complete / mark:
            wait_for_disk(folder)
        place = folder / file.relative_to(complete)
        place.parent.mkdir(parents=True, exist_ok=True)
        with LocalFile(place).replacing() as temporary:
            shutil.copy2(file, temporary, follow_symlinks=False)
    wait_for_disk(folder)


def _files(folder: Path, mark: str) -> list[Path]:
    """Return the files of a folder at any depth, its mark last."""
    files = (path for path in folder.rglob("*") if path.is_symlink() or not path.is_dir())
    return sorted(files, key=lambda path: path == folder / mark)


def _wait(path: Path) -> None:
    if sys.platform == "win32":
        return  # Windows cannot open folders.
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    except OSError:
        if not path.is_dir():  # Some file systems cannot sync folders.
            raise
    finally:
        os.close(descriptor)


def remove(path: AnyPath) -> None:
    """Remove a file, or a local folder with its content, even if a process still writes there."""
    if isinstance(path, Path) and path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
    else:
        path.unlink(missing_ok=True)

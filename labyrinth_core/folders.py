"""Folders that become complete: all their files appear together, or none.

A local folder is made under another name and renamed into its place; the folder that it replaces
stays until then. An object store cannot rename: there a folder is complete once it has its mark,
which is removed first and written last. Datasets, artifacts and caches become complete like this.
"""

from __future__ import annotations

import errno
import os
import shutil
import sys
from abc import ABC, abstractmethod
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, overload

from labyrinth_core.storage import AnyPath, File, LocalFile

if TYPE_CHECKING:
    from labyrinth_core.remote import RemotePath

_REPLACED = ".replaced"
"""The suffix of a folder that another folder replaces."""

_COMPLETE = ".complete"
"""The suffix of a folder whose files are copied to a place that cannot be renamed. The folder is
complete once it has its mark."""

_NOT_RENAMED = (errno.EXDEV, errno.EBUSY)
"""The errors of renaming a folder in a lower layer of a container, or a mount point."""


@dataclass(frozen=True)
class WholeFolder(ABC):
    """A folder that is complete or not there at all."""

    folder: AnyPath
    """Its place; of a link to a folder, the target, which is replaced instead of the link."""
    mark: str
    """The file whose absence tells readers that the folder is unfinished."""
    is_replaced_at_once: ClassVar[bool]
    """Whether the folder that is there stays until the new one is complete."""

    @overload
    @staticmethod
    def of(folder: Path, mark: str) -> LocalFolder: ...
    @overload
    @staticmethod
    def of(folder: AnyPath, mark: str) -> WholeFolder: ...
    @staticmethod
    def of(folder: AnyPath, mark: str) -> WholeFolder:
        """Return the folder at a local path or in an object store."""
        if isinstance(folder, Path):
            is_link = folder.is_symlink()
            return LocalFolder(Path(os.path.realpath(folder)) if is_link else folder, mark)
        return RemoteFolder(folder, mark)

    @abstractmethod
    def making(self, beside: AnyPath) -> AnyPath:
        """Return the folder to make files in; `beside` is one on the same disk as a local one."""

    @abstractmethod
    def made(self) -> Any:
        """Return a context with an empty folder to make files in, which then becomes complete."""

    @abstractmethod
    def complete(self, made: Any) -> None:
        """Put the folder in which all files were made in its place."""

    @abstractmethod
    def recover(self) -> None:
        """Finish or undo what a crash in `complete` has left."""

    @abstractmethod
    def leftovers(self, folder: Any, names: Collection[str]) -> list[Path]:
        """Return what killed processes left of files with these names in a folder."""

    @abstractmethod
    def is_covered(self, changed: float) -> bool:
        """Return whether a file that changed at this time was complete before the mark was."""


@dataclass(frozen=True)
class LocalFolder(WholeFolder):
    """A local folder, made under another name and renamed into its place."""

    folder: Path
    is_replaced_at_once: ClassVar[bool] = True

    def making(self, beside: AnyPath) -> AnyPath:
        """Return the folder that the caller offers."""
        return beside

    @contextmanager
    def made(self) -> Iterator[Path]:
        """Yield a new folder beside the place, and put it in its place at the end.

        After a kill, it is one of the `temporaries` of the folder's name.
        """
        scratch = LocalFile(self.folder).temporary()
        try:
            made = scratch / self.folder.name
            made.mkdir(parents=True)
            yield made
            self.complete(made)
        finally:
            File(scratch).remove()

    def complete(self, made: Path) -> None:
        """Sync a folder to disk and move it to its place, in place of the folder that is there.

        If a folder cannot be renamed, its files are copied, the mark last. After a crash on the
        way, `recover` puts the replaced folder back or finishes copying.

        Args:
            made: The new folder, beside its place or deeper, on the same disk.
        """
        _sync_all(made)
        try:
            if self.folder.exists():
                self.folder.replace(LocalFile(self.folder).temporary(_REPLACED))
            made.replace(self.folder)
        except OSError as error:
            if error.errno not in _NOT_RENAMED:
                raise
            complete = LocalFile(self.folder).temporary(_COMPLETE)
            for file in self._files(made):
                path = complete / file.relative_to(made)
                path.parent.mkdir(parents=True, exist_ok=True)
                file.replace(path)
            File(made).remove()
        self.recover()
        _sync(self.folder.parent)

    def recover(self) -> None:
        """Complete a folder that a crash in `complete` left, or put the replaced one back."""
        folder = self.folder
        for complete in LocalFile.temporaries(folder.parent, [folder.name], _COMPLETE):
            if (complete / self.mark).exists():
                self._copy(complete)
            File(complete).remove()
        for replaced in LocalFile.temporaries(folder.parent, [folder.name], _REPLACED):
            if folder.exists():
                File(replaced).remove()
            else:
                replaced.replace(folder)

    def _copy(self, complete: Path) -> None:
        """Replace the content of the folder with the files of another folder, the mark last."""
        self.folder.mkdir(exist_ok=True)
        for old in sorted(self.folder.iterdir(), key=lambda path: path.name != self.mark):
            File(old).remove()
        for file in self._files(complete):
            if file == complete / self.mark:
                _sync_all(self.folder)
            path = self.folder / file.relative_to(complete)
            path.parent.mkdir(parents=True, exist_ok=True)
            with LocalFile(path).replacing() as temporary:
                shutil.copy2(file, temporary, follow_symlinks=False)
        _sync_all(self.folder)

    def _files(self, folder: Path) -> list[Path]:
        """Return the files of a folder at any depth, the mark last."""
        files = (path for path in folder.rglob("*") if path.is_symlink() or not path.is_dir())
        return sorted(files, key=lambda path: path == folder / self.mark)

    def leftovers(self, folder: Any, names: Collection[str]) -> list[Path]:
        """Return the temporary files of these names."""
        return LocalFile.temporaries(folder, names)

    def is_covered(self, changed: float) -> bool:  # noqa: ARG002
        """Return False: a file that counts as complete is hashed."""
        return False


@dataclass(frozen=True)
class RemoteFolder(WholeFolder):
    """A folder in an object store, where each file appears complete under its own name."""

    folder: RemotePath
    is_replaced_at_once: ClassVar[bool] = False

    def making(self, beside: AnyPath) -> AnyPath:  # noqa: ARG002
        """Return the folder itself."""
        return self.folder

    @contextmanager
    def made(self) -> Iterator[RemotePath]:
        """Yield the folder itself, which the caller has emptied; the caller writes the mark."""
        yield self.folder

    def complete(self, made: Any) -> None:
        """Do nothing: the caller has written the mark into the folder."""

    def recover(self) -> None:
        """Do nothing: without its mark the folder is unfinished."""

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


def _sync_all(folder: Path) -> None:
    """Sync a folder and all its content to disk, so that they survive a power failure."""
    for path in [*folder.rglob("*"), folder]:
        if not path.is_symlink():  # It may be broken.
            _sync(path)


def _sync(path: Path) -> None:
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

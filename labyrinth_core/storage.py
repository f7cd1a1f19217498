"""Files in a local folder or in an object store, behind one interface.

A local folder is a `pathlib.Path`. A URL that fsspec knows, such as `s3://bucket/data`, is a
`RemotePath`, which has the methods of `Path` that this project needs. Files are written whole or
not at all: a `LocalFile` is renamed into its place, a `RemoteFile` is a single upload. A symbolic
link is replaced itself, so its target never changes; a device or a folder is never replaced.
"""

from __future__ import annotations

import errno
import hashlib
import json
import os
import shutil
from collections import Counter
from collections.abc import Callable, Collection, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn, TypeAlias
from uuid import uuid4

from labyrinth_core.errors import DatasetError, naming, one_line

if TYPE_CHECKING:
    from labyrinth_core.remote import RemoteFile, RemotePath


def folder_at(source: str | Path) -> AnyPath:
    """Return the folder at a path or a URL.

    Raises:
        ValueError: The URL names no bucket or folder, fsspec does not know its protocol or lacks a
            library for it, or the path begins with `~` and the home folder is unknown.
    """
    text = str(source)
    if text.startswith("file://"):
        return Path(text.removeprefix("file://"))
    if "://" not in text:
        try:
            return Path(source).expanduser()
        except RuntimeError as error:
            raise ValueError(f"{text}: the home folder of the user is unknown") from error
    from labyrinth_core.remote import RemotePath, filesystem

    protocol, _, name = text.partition("://")
    if not name.strip("/"):
        raise ValueError(f"{text} names no bucket or folder: give one, such as {protocol}://name")
    try:
        filesystem(protocol)
    except ImportError as error:
        install = "pip install 'labyrinth-datasets[s3]'" if protocol == "s3" else one_line(error)
        raise ValueError(f"{text} needs a library that is missing: {install}") from error
    except Exception as error:  # Each file system may fail to start in its own way.
        raise ValueError(f"{text}: {one_line(error)}") from error
    return RemotePath(text.rstrip("/"))


AnyPath: TypeAlias = "Path | RemotePath"


@dataclass(frozen=True)
class File:
    """A file, here or in an object store, which is written whole or not at all."""

    path: AnyPath

    def write_bytes(self, content: bytes) -> None:
        """Write the file.

        Raises:
            OSError: The file cannot be written, or something that is not a regular file is there.
        """
        self._own.write_bytes(content)

    def write_text(self, text: str) -> None:
        """Write the file as text in UTF-8."""
        self.write_bytes(text.encode())

    def read_json(self) -> Any:
        """Return the content of a JSON file.

        Raises:
            OSError, ValueError, RecursionError: The file cannot be read, or holds a NaN, an
                infinity, or an object with a duplicate key.
        """
        return json.loads(
            self.path.read_bytes(), parse_constant=_no_number, object_pairs_hook=_unambiguous
        )

    def sha256(self) -> str:
        """Return the SHA-256 of the file, in hexadecimal digits."""
        digest = hashlib.sha256()
        with self.path.open("rb") as file:
            while block := file.read(1 << 20):
                digest.update(block)
        return digest.hexdigest()

    def size_and_time(self) -> tuple[int, float]:
        """Return the size in bytes and the modification time in seconds, without reading it."""
        status = self.path.stat()
        return status.st_size, status.st_mtime

    def local_copy(self) -> AbstractContextManager[Path]:
        """Yield an absolute local path with the content: its own, or of a temporary download.

        Arrow would take a relative path with a colon for a URL.
        """
        return self._own.local_copy()

    def replacing(self, scratch: AnyPath | None = None) -> AbstractContextManager[Path]:
        """Yield a temporary local path, which replaces the file when the block ends.

        Args:
            scratch: The folder of the temporary file, on the same disk as a local path; None for
                the file's own. After a kill it is one of the `temporaries` there. A process that
                was given up may still write there while another makes the same file.

        Raises:
            OSError: The file cannot be written, or something that is not a regular file is there.
        """
        return self._own.replacing(scratch)

    def held(self, name: str, before_waiting: Callable[[], None]) -> AbstractContextManager[bool]:
        """Hold the lock of a file or folder in this folder, which one process at a time changes.

        Object stores and some file systems have no locks: there the context begins at once. The
        context gives whether the lock is held, so that what other processes left there is of dead
        ones. The folder is created if it does not exist; then removed if it is empty at the end.

        Args:
            name: The file or folder to change. Temporary files of it, from killed processes, are
                removed.
            before_waiting: Called before waiting for another process that holds the lock.

        Raises:
            DatasetError: A file is in the place of the folder.
        """
        return self._own.held(name, before_waiting)

    def names(self) -> list[str]:
        """Return the paths of all files in this folder, relative to it."""
        return self._own.names()

    def remove(self) -> None:
        """Remove the file, or a local folder with its content, even if a process writes there."""
        self._own.remove()

    @property
    def _own(self) -> LocalFile | RemoteFile:
        if isinstance(self.path, Path):
            return LocalFile(self.path)
        from labyrinth_core.remote import RemoteFile

        return RemoteFile(self.path)


@dataclass(frozen=True)
class LocalFile(File):
    """A file in a local folder, which is replaced by renaming a temporary one."""

    path: Path

    def replaceable(self) -> Path:
        """Return the path if its file may be replaced or does not exist; a link itself may be.

        Raises:
            FileExistsError: The path is a folder or a device.
        """
        path = self.path
        if not path.is_symlink() and path.exists() and not path.is_file():
            reason = "is not a regular file, so it is not replaced"
            raise FileExistsError(errno.EEXIST, reason, str(path))
        return path

    def target(self) -> Path:
        """Return the file that a user names for output: a link leads to its target.

        Raises:
            FileExistsError: The path leads to a folder or a device.
        """
        is_link = self.path.is_symlink()
        return LocalFile(Path(os.path.realpath(self.path)) if is_link else self.path).replaceable()

    def temporary(self, suffix: str = ".tmp") -> Path:
        """Return a new temporary name in the same folder.

        The name ends in a hash of the rest, by which `temporaries` recognises it.
        """
        name = f".{self.path.name}.{uuid4().hex[:12]}"
        return self.path.with_name(_sealed(name, suffix))

    @staticmethod
    def temporaries(folder: Path, names: Collection[str], suffix: str = ".tmp") -> list[Path]:
        """Return the existing paths named by `temporary`, left by killed processes.

        Args:
            folder: The folder.
            names: The names in it whose temporary paths to return.
            suffix: As for `temporary`.
        """
        paths = []
        for path in folder.iterdir() if folder.is_dir() else ():
            name = path.name.removesuffix(suffix).rpartition(".")[0]
            if name.rpartition(".")[0][1:] in names and path.name == _sealed(name, suffix):
                paths.append(path)
        return paths

    def naming(self, temporary: Path | None = None) -> AbstractContextManager[None]:
        """Put the path into an OSError that names no file, as for a full disk, or `temporary`."""
        return naming(self.path, temporary)

    def write_bytes(self, content: bytes) -> None:
        """Write the file."""
        with self.replacing() as temporary:
            temporary.write_bytes(content)

    @contextmanager
    def replacing(self, scratch: AnyPath | None = None) -> Iterator[Path]:
        """Yield a temporary path, which then replaces the file; see `File.replacing`."""
        # Another process that makes the same file uses another name.
        path = self.replaceable()
        beside = path if scratch is None else Path(str(scratch)).absolute() / path.name
        temporary = LocalFile(beside).temporary()
        try:
            with self.naming(temporary):
                yield temporary
                temporary.replace(path)
        finally:
            temporary.unlink(missing_ok=True)

    @contextmanager
    def local_copy(self) -> Iterator[Path]:
        """Yield the absolute path."""
        yield self.path.absolute()

    @contextmanager
    def held(self, name: str, before_waiting: Callable[[], None]) -> Iterator[bool]:
        """Hold the lock of a name in the folder; see `File.held`."""
        folder = self.path
        with ExitStack() as stack:
            # Callbacks run last to first, so the innermost folder is removed before the others.
            for path in [*reversed(folder.parents), folder]:
                if not path.exists():
                    stack.callback(_remove_if_empty, path)
            with suppress(OSError):  # A folder that cannot be written is reported by the caller.
                folder.mkdir(parents=True, exist_ok=True)
            if file := next((path for path in [folder, *folder.parents] if path.is_file()), None):
                raise DatasetError(f"{file} is a file: move it, or choose another folder")
            is_locked = False
            try:
                stack.enter_context(LocalFile(folder / f".{name}.lock").locked(before_waiting))
                is_locked = True
                for unfinished in LocalFile.temporaries(folder, [name]):
                    LocalFile(unfinished).remove()
            except OSError:  # Reported by the caller, or the file system has no locks.
                pass
            yield is_locked

    def names(self) -> list[str]:
        """Return the paths of all files in the folder at any depth, relative to it."""
        files = [path for path in self.path.rglob("*") if path.is_symlink() or not path.is_dir()]
        return sorted(path.relative_to(self.path).as_posix() for path in files)

    def remove(self) -> None:
        """Remove the file, or the folder with its content."""
        if self.path.is_dir() and not self.path.is_symlink():
            shutil.rmtree(self.path, ignore_errors=True)
        else:
            self.path.unlink(missing_ok=True)

    @contextmanager
    def locked(
        self, before_waiting: Callable[[], None] = lambda: None, *, wait: bool = True
    ) -> Iterator[None]:
        """Hold this lock file, which is created if necessary and removed at the end.

        Only this method may create, remove or rename it.

        Args:
            before_waiting: Called before waiting for another process that holds the lock.
            wait: Whether to wait at all.

        Raises:
            TimeoutError: Another process holds the lock, and `wait` is false.
            OSError: The file cannot be created, or its file system does not support locks.
        """
        from filelock import FileLock, Timeout

        lock = FileLock(self.path, fallback_to_soft=False)
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
                self.path.unlink()
            lock.release()


def _remove_if_empty(folder: Path) -> None:
    with suppress(OSError):
        folder.rmdir()


def _sealed(name: str, suffix: str) -> str:
    return f"{name}.{hashlib.sha256(os.fsencode(name)).hexdigest()[:8]}{suffix}"


def _unambiguous(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    values = dict(pairs)
    if len(values) < len(pairs):
        twice, _ = Counter(name for name, _ in pairs).most_common(1)[0]
        raise ValueError(f"{twice!r:.60} appears twice in one object")
    return values


def _no_number(word: str) -> NoReturn:
    raise ValueError(f"{word} is not a JSON number")

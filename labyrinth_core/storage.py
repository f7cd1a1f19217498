"""Files in a local folder or in an object store, behind one interface.

A local folder is a `pathlib.Path`. A URL that fsspec knows, such as `s3://bucket/data`, is a
`RemotePath`, which has the methods of `Path` that this project needs. Writes are atomic: a local
file is renamed into place, a remote file is a single upload. A symbolic link is replaced itself, so
its target never changes; a device or a folder is never replaced.
"""

from __future__ import annotations

import errno
import hashlib
import json
import os
import shutil
import tempfile
from collections import Counter
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any, BinaryIO, NoReturn, cast
from uuid import uuid4

from labyrinth_core.errors import one_line


def folder_at(place: str | Path) -> AnyPath:
    """Return the folder at a path or a URL.

    Raises:
        ValueError: The URL names no bucket or folder, fsspec does not know its protocol or lacks a
            library for it, or the path begins with `~` and the home folder is unknown.
    """
    text = str(place)
    if text.startswith("file://"):
        return Path(text.removeprefix("file://"))
    if "://" not in text:
        try:
            return Path(place).expanduser()
        except RuntimeError as error:
            raise ValueError(f"{text}: the home folder of the user is unknown") from error
    protocol, _, name = text.partition("://")
    if not name.strip("/"):
        raise ValueError(f"{text} names no bucket or folder: give one, such as {protocol}://name")
    try:
        _filesystem(protocol)
    except ImportError as error:
        install = "pip install 'labyrinth-datasets[s3]'" if protocol == "s3" else one_line(error)
        raise ValueError(f"{text} needs a library that is missing: {install}") from error
    except Exception as error:  # Each file system may fail to start in its own way.
        raise ValueError(f"{text}: {one_line(error)}") from error
    return RemotePath(text.rstrip("/"))


def _filesystem(protocol: str) -> Any:
    """Return fsspec's shared file system of a protocol, whose library finds the credentials."""
    import fsspec

    if protocol == "hf":
        from labyrinth_core import hub

        hub.prepare_client()
    # A cached listing would hide what other processes write.
    return fsspec.filesystem(protocol, use_listings_cache=False)


@dataclass(frozen=True)
class RemotePath:
    """A file or folder in an object store, with methods of `Path`.

    Every method raises OSError if the store fails, FileNotFoundError if nothing is there.
    """

    url: str

    def __str__(self) -> str:
        return self.url

    def __truediv__(self, name: str) -> RemotePath:
        return RemotePath(f"{self.url}/{name}")

    @property
    def name(self) -> str:
        return self.url.rpartition("/")[2]

    @property
    def parent(self) -> RemotePath:
        return RemotePath(self.url.rpartition("/")[0])

    def _ask(self, question: Callable[[Any, str], Any]) -> Any:
        """Call `question` with the file system and the path in it, and return its result."""
        try:
            store = _filesystem(self.url.partition("://")[0])
            place = store._strip_protocol(self.url)
            if not self.url.startswith("hf://"):
                return question(store, place)
            from labyrinth_core import hub

            try:
                return hub.repeated(lambda: question(store, place))
            except FileNotFoundError:  # Perhaps by a listing that came wrong, and is kept.
                store.invalidate_cache()
                return hub.repeated(lambda: question(store, place))
        except FileNotFoundError:
            raise
        except Exception as error:  # Each store has errors of its own, such as botocore's.
            if isinstance(error, OSError) and error.filename:
                raise
            number = getattr(error, "errno", None) or errno.EIO
            reason = f"{type(error).__name__}: {one_line(error)}"
            raise OSError(number, reason, self.url) from error

    def _kind(self, *, anew: bool = False) -> str | None:
        """Return `file` or `directory`, or None if nothing is there.

        The store's own `exists`, `isfile` and `isdir` may take any error for no.

        Args:
            anew: Whether to ask for a new listing of a store that keeps some.
        """

        def asked(store: Any, path: str) -> str:
            if anew:
                store.invalidate_cache()
            return str(store.info(path)["type"])

        try:
            return cast("str", self._ask(asked))
        except FileNotFoundError:
            return None

    def exists(self) -> bool:
        return self._kind() is not None

    def is_dir(self) -> bool:
        return self._kind(anew=True) == "directory"

    def is_file(self) -> bool:
        return self._kind() == "file"

    def glob(self, pattern: str) -> Iterator[RemotePath]:
        """Yield the paths that match `pattern`; this folder's own path is taken literally."""
        first, _, rest = pattern.partition("/")
        for name, is_dir in self._listed():
            if fnmatchcase(name, first) and not rest:
                yield self / name
            elif fnmatchcase(name, first) and is_dir:
                yield from (self / name).glob(rest)

    def _listed(self) -> list[tuple[str, bool]]:
        """Return the sorted names in this folder, each with whether it is a folder."""
        try:
            base, found = self._ask(lambda store, path: (path, store.ls(path, detail=True)))
        except FileNotFoundError:
            return []
        paths = {each["name"].rstrip("/"): each["type"] == "directory" for each in found}
        paths.pop(base.rstrip("/"), None)  # The folder itself, or a file.
        return sorted((path.rpartition("/")[2], is_dir) for path, is_dir in paths.items())

    def iterdir(self) -> Iterator[RemotePath]:
        return self.glob("*")

    def is_symlink(self) -> bool:
        """Return False: an object store has no links."""
        return False

    def absolute(self) -> RemotePath:
        """Return the same path: every URL is absolute."""
        return self

    def rmdir(self) -> None:
        """Do nothing: an object store has no empty folders."""

    def mkdir(self, *, parents: bool = False, exist_ok: bool = False) -> None:
        """Do nothing: an object store makes a folder with the first file in it."""

    def open(self, mode: str) -> BinaryIO:
        """Open for reading, mode "rb"."""
        return cast("BinaryIO", self._ask(lambda store, path: store.open(path, mode)))

    def open_ranges(self) -> BinaryIO:
        """Open for reading by byte ranges, each downloaded as requested and none ahead."""
        opened = self._ask(lambda store, path: store.open(path, "rb", cache_type="none"))
        return cast("BinaryIO", opened)

    def read_bytes(self) -> bytes:
        return bytes(self._ask(lambda store, path: store.cat_file(path)))

    def read_text(self, encoding: str) -> str:
        return self.read_bytes().decode(encoding)

    def upload(self, local: Path) -> None:
        """Upload a local file to this path."""
        self._ask(lambda store, path: store.put_file(str(local), path))

    def unlink(self, *, missing_ok: bool = False) -> None:
        if not missing_ok or self.exists():
            self._ask(lambda store, path: store.rm_file(path))


AnyPath = Path | RemotePath


@dataclass(frozen=True)
class File:
    """A file, here or in an object store, which is written whole or not at all."""

    path: AnyPath

    def write_bytes(self, content: bytes) -> None:
        """Write the file.

        Raises:
            OSError: The file cannot be written, or something that is not a regular file is there.
        """
        if isinstance(self.path, RemotePath):
            self.path._ask(lambda store, place: store.pipe_file(place, content))
            return
        with LocalFile(self.path).replacing() as temporary:
            temporary.write_bytes(content)

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

    def remove(self) -> None:
        """Remove the file, or a local folder with its content, even if a process writes there."""
        if isinstance(self.path, Path) and self.path.is_dir() and not self.path.is_symlink():
            shutil.rmtree(self.path, ignore_errors=True)
        else:
            self.path.unlink(missing_ok=True)

    def size_and_time(self) -> tuple[int, float]:
        """Return the size in bytes and the modification time in seconds, without reading it."""
        if isinstance(self.path, Path):
            status = self.path.stat()
            return status.st_size, status.st_mtime
        size, written = self.path._ask(
            lambda store, place: (store.size(place), store.modified(place))
        )
        return int(size), written.timestamp()

    @contextmanager
    def local_copy(self) -> Iterator[Path]:
        """Yield an absolute local path with the content: its own, or of a temporary download.

        Arrow would take a relative path with a colon for a URL.
        """
        if isinstance(self.path, Path):
            yield self.path.absolute()
            return
        with tempfile.TemporaryDirectory(prefix="labyrinth-") as folder:
            local = Path(folder) / self.path.name
            self.path._ask(lambda store, place: store.get_file(place, str(local)))
            yield local


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
        found = []
        for path in folder.iterdir() if folder.is_dir() else ():
            name = path.name.removesuffix(suffix).rpartition(".")[0]
            if name.rpartition(".")[0][1:] in names and path.name == _sealed(name, suffix):
                found.append(path)
        return found

    @contextmanager
    def naming(self, temporary: Path | None = None) -> Iterator[None]:
        """Put the path into an OSError that names no file, as for a full disk, or `temporary`."""
        try:
            yield
        except OSError as error:
            if error.filename in (None, str(temporary)):
                error.filename = str(self.path)
            raise

    @contextmanager
    def replacing(self) -> Iterator[Path]:
        """Yield a temporary path, which replaces the file when the block ends.

        Raises:
            OSError: The file cannot be written, or something that is not a regular file is there.
        """
        # Another process that makes the same file uses another name.
        path = self.replaceable()
        temporary = self.temporary()
        try:
            with self.naming(temporary):
                yield temporary
                temporary.replace(path)
        finally:
            temporary.unlink(missing_ok=True)

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


def _sealed(name: str, suffix: str) -> str:
    return f"{name}.{hashlib.sha256(os.fsencode(name)).hexdigest()[:8]}{suffix}"


def _unambiguous(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) < len(pairs):
        twice, _ = Counter(name for name, _ in pairs).most_common(1)[0]
        raise ValueError(f"{twice!r:.60} appears twice in one object")
    return found


def _no_number(word: str) -> NoReturn:
    raise ValueError(f"{word} is not a JSON number")

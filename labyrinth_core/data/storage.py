"""Files in a local folder or in an object store, behind one interface.

A local folder is a `pathlib.Path`. A URL that fsspec knows, such as `s3://bucket/data`, is a
`RemotePath`, which has those methods of `Path` that are needed here. A file appears whole: a local
one by a rename, a remote one by a single upload. Links are followed to the file that is replaced;
what is there and is not a regular file, such as a device or a folder, is never replaced.
"""

from __future__ import annotations

import errno
import hashlib
import json
import os
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any, BinaryIO, NoReturn, cast
from uuid import uuid4

from labyrinth_core.data.errors import one_line


def folder_at(place: str | Path) -> AnyPath:
    """Return the folder at a path or a URL.

    Raises:
        ValueError: The URL names nothing, or fsspec knows no such URL, or needs a library for it
            that is not installed; or the path begins with a home folder that is unknown.
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
    except Exception as error:  # Of any kind: each file system has its own way to start.
        raise ValueError(f"{text}: {one_line(error)}") from error
    return RemotePath(text.rstrip("/"))


def _filesystem(protocol: str) -> Any:
    """Return the file system of a protocol, which fsspec keeps; its library finds credentials."""
    import fsspec

    if protocol == "hf":
        from labyrinth_core.data.hub import limit_silence

        limit_silence()
    # A cached listing would hide what other processes write.
    return fsspec.filesystem(protocol, use_listings_cache=False)


@dataclass(frozen=True)
class RemotePath:
    """A file or folder of an object store; its methods are those of `Path`.

    Every method raises OSError where the store fails, FileNotFoundError where nothing is there.
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
        """Return what a function returns for the file system and the path in it."""
        try:
            store = _filesystem(self.url.partition("://")[0])
            return question(store, store._strip_protocol(self.url))
        except FileNotFoundError:
            raise
        except Exception as error:  # Of any kind: each store has its own, such as botocore's.
            if isinstance(error, OSError) and error.filename:
                raise
            number = getattr(error, "errno", None) or errno.EIO
            reason = f"{type(error).__name__}: {one_line(error)}"
            raise OSError(number, reason, self.url) from error

    def exists(self) -> bool:
        return bool(self._ask(lambda store, path: store.exists(path)))

    def is_dir(self) -> bool:
        return bool(self._ask(lambda store, path: store.isdir(path)))

    def is_file(self) -> bool:
        return bool(self._ask(lambda store, path: store.isfile(path)))

    def glob(self, pattern: str) -> Iterator[RemotePath]:
        """Yield what matches a pattern; names of folders that look like patterns are none."""
        first, _, rest = pattern.partition("/")
        for name, is_dir in self._listed():
            if fnmatchcase(name, first) and not rest:
                yield self / name
            elif fnmatchcase(name, first) and is_dir:
                yield from (self / name).glob(rest)

    def _listed(self) -> list[tuple[str, bool]]:
        """Return the names in a folder, sorted, each with whether it is a folder."""
        try:
            base, found = self._ask(lambda store, path: (path, store.ls(path, detail=True)))
        except FileNotFoundError:
            return []
        paths = {each["name"].rstrip("/"): each["type"] == "directory" for each in found}
        paths.pop(base.rstrip("/"), None)  # The folder itself, or a file.
        return sorted((path.rpartition("/")[2], is_dir) for path, is_dir in paths.items())

    def iterdir(self) -> Iterator[RemotePath]:
        return self.glob("*")

    def mkdir(self, *, parents: bool = False, exist_ok: bool = False) -> None:
        """Do nothing: an object store makes a folder with the first file in it."""

    def open(self, mode: str) -> BinaryIO:
        """Open for reading, mode "rb"."""
        return cast("BinaryIO", self._ask(lambda store, path: store.open(path, mode)))

    def open_ranges(self) -> BinaryIO:
        """Open for reading in ranges, of which each is downloaded as it is and none ahead."""
        opened = self._ask(lambda store, path: store.open(path, "rb", cache_type="none"))
        return cast("BinaryIO", opened)

    def read_bytes(self) -> bytes:
        return bytes(self._ask(lambda store, path: store.cat_file(path)))

    def read_text(self, encoding: str) -> str:
        return self.read_bytes().decode(encoding)

    def upload(self, local: Path) -> None:
        """Make this the content of a local file."""
        self._ask(lambda store, path: store.put_file(str(local), path))

    def unlink(self, *, missing_ok: bool = False) -> None:
        if not missing_ok or self.exists():
            self._ask(lambda store, path: store.rm_file(path))


AnyPath = Path | RemotePath


def file_at(path: Path) -> Path:
    """Return the place of a file that is to be written, to which links at the path lead.

    Raises:
        FileExistsError: Something is there that is not a regular file.
    """
    if path.exists() and not path.is_file():
        reason = "is not a regular file, so it is not replaced"
        raise FileExistsError(errno.EEXIST, reason, str(path))
    return Path(os.path.realpath(path)) if path.is_symlink() else path


def temporary_beside(path: Path, suffix: str = ".tmp") -> Path:
    """Return a new name beside a path, for what is not in its place yet or no longer.

    The end of the name is a hash of the rest, by which `temporaries` knows it.
    """
    return path.with_name(_sealed(f".{path.name}.{uuid4().hex[:12]}", suffix))


def temporaries(path: Path, suffix: str = ".tmp") -> list[Path]:
    """Return what is there under names of `temporary_beside`, left by killed processes."""
    found = []
    for each in path.parent.iterdir() if path.parent.is_dir() else ():
        name = each.name.removesuffix(suffix).rpartition(".")[0]
        if name.rpartition(".")[0] == f".{path.name}" and each.name == _sealed(name, suffix):
            found.append(each)
    return found


def _sealed(name: str, suffix: str) -> str:
    return f"{name}.{hashlib.sha256(os.fsencode(name)).hexdigest()[:8]}{suffix}"


@contextmanager
def naming(path: Path, temporary: Path | None = None) -> Iterator[None]:
    """Name a path in errors of the block that name none, as of a full disk, or a temporary file."""
    try:
        yield
    except OSError as error:
        if error.filename in (None, str(temporary)):
            error.filename = str(path)
        raise


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Lend the name of a new file, which then takes the place of a local one.

    Raises:
        OSError: The file cannot be written, or something that is not a regular file is there.
    """
    target = file_at(path)
    # Another process that makes the same file uses another name.
    temporary = temporary_beside(target)
    try:
        with naming(path, temporary):
            yield temporary
        temporary.replace(target)
    finally:
        temporary.unlink(missing_ok=True)


def write_bytes(path: AnyPath, content: bytes) -> None:
    """Write a file, whole or not at all.

    Raises:
        OSError: The file cannot be written, or something that is not a regular file is there.
    """
    if isinstance(path, RemotePath):
        path._ask(lambda store, place: store.pipe_file(place, content))
        return
    with replacing(path) as temporary:
        temporary.write_bytes(content)


def write_text(path: AnyPath, text: str) -> None:
    """Write a text file in UTF-8, whole or not at all."""
    write_bytes(path, text.encode())


def read_json(path: AnyPath) -> Any:
    """Return what a JSON file holds.

    Raises:
        OSError, ValueError, RecursionError: It cannot be read, or holds a NaN, an infinity, or an
            object that has a name twice.
    """
    return json.loads(path.read_bytes(), parse_constant=_no_number, object_pairs_hook=_unambiguous)


def _unambiguous(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) < len(pairs):
        twice, _ = Counter(name for name, _ in pairs).most_common(1)[0]
        raise ValueError(f"{twice!r:.60} is there twice in one object")
    return found


def _no_number(word: str) -> NoReturn:
    raise ValueError(f"{word} is no number of JSON")


def file_sha256(path: AnyPath) -> str:
    """Return the SHA-256 of a file, in hexadecimal digits."""
    digest = hashlib.sha256()
    with path.open("rb") as file:
        while block := file.read(1 << 20):
            digest.update(block)
    return digest.hexdigest()


def size_and_time(path: AnyPath) -> tuple[int, float]:
    """Return the bytes of a file, and when it was written, in seconds; both without reading it."""
    if isinstance(path, Path):
        status = path.stat()
        return status.st_size, status.st_mtime
    size, written = path._ask(lambda store, place: (store.size(place), store.modified(place)))
    return int(size), written.timestamp()


@contextmanager
def local_copy(path: AnyPath) -> Iterator[Path]:
    """Lend a local file with the content of a path: itself, or a temporary download.

    Its path is absolute, as Arrow takes a relative one with a colon for a URL.
    """
    if isinstance(path, Path):
        yield path.absolute()
        return
    with tempfile.TemporaryDirectory(prefix="labyrinth-") as folder:
        local = Path(folder) / path.name
        path._ask(lambda store, place: store.get_file(place, str(local)))
        yield local


@contextmanager
def locked(
    path: Path, before_waiting: Callable[[], None] = lambda: None, *, wait: bool = True
) -> Iterator[None]:
    """Hold the lock of a file, which is made if need be and removed at the end.

    Args:
        path: The file; only this function may make, remove or rename it.
        before_waiting: Called if another process has the lock.
        wait: Whether to wait for another process.

    Raises:
        TimeoutError: Another process has the lock, and `wait` is false.
        OSError: The file cannot be made, or its file system has no locks.
    """
    from filelock import FileLock, Timeout

    lock = FileLock(path, fallback_to_soft=False)
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
            path.unlink()
        lock.release()

"""Files in a local folder or in an object store, behind one interface.

A local folder is a `pathlib.Path`. A URL that fsspec knows, such as `s3://bucket/data`, is a
`RemotePath`, which has those methods of `Path` that are needed here. A file appears whole: a local
one by a rename, a remote one by a single upload.
"""

from __future__ import annotations

import errno
import hashlib
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, cast
from uuid import uuid4

from labyrinth_core.data.errors import one_line


def folder_at(place: str | Path) -> AnyPath:
    """Return the folder at a path or a URL.

    Raises:
        ValueError: The URL names nothing, or fsspec knows no such URL, or needs a library for it
            that is not installed.
    """
    text = str(place)
    if text.startswith("file://"):
        return Path(text.removeprefix("file://"))
    if "://" not in text:
        return Path(place).expanduser()
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
        base = self._ask(lambda _, path: path)
        for each in sorted(self._ask(lambda store, path: store.glob(f"{path}/{pattern}"))):
            yield self / each[len(base) + 1 :]

    def iterdir(self) -> Iterator[RemotePath]:
        return self.glob("*")

    def mkdir(self, *, parents: bool = False, exist_ok: bool = False) -> None:
        """Do nothing: an object store makes a folder with the first file in it."""

    def open(self, mode: str) -> BinaryIO:
        """Open for reading, mode "rb"."""
        return cast("BinaryIO", self._ask(lambda store, path: store.open(path, mode)))

    def read_bytes(self) -> bytes:
        return bytes(self._ask(lambda store, path: store.cat_file(path)))

    def read_text(self, encoding: str) -> str:
        return self.read_bytes().decode(encoding)

    def unlink(self, *, missing_ok: bool = False) -> None:
        if not missing_ok or self.exists():
            self._ask(lambda store, path: store.rm_file(path))


AnyPath = Path | RemotePath


def write_bytes(path: AnyPath, content: bytes) -> None:
    """Write a file, whole or not at all."""
    if isinstance(path, RemotePath):
        path._ask(lambda store, place: store.pipe_file(place, content))
        return
    # Another process that makes the same file uses another name.
    temporary = path.with_name(f".{path.name}.{uuid4().hex[:12]}.tmp")
    try:
        temporary.write_bytes(content)
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


def write_text(path: AnyPath, text: str) -> None:
    """Write a text file in UTF-8, whole or not at all."""
    write_bytes(path, text.encode())


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
    """Lend a local file with the content of a path: itself, or a temporary download."""
    if isinstance(path, Path):
        yield path
        return
    with tempfile.TemporaryDirectory(prefix="labyrinth-") as folder:
        local = Path(folder) / path.name
        path._ask(lambda store, place: store.get_file(place, str(local)))
        yield local


@contextmanager
def new_file(path: AnyPath, scratch: AnyPath) -> Iterator[Path]:
    """Lend the name of a local file to be made, which is then moved or uploaded to a path.

    Args:
        path: The final place of the file, where it appears whole or not at all.
        scratch: Folder for the temporary file, on the same disk as a local path. A process that
            was given up may still write there while another makes the same file.
    """
    place = scratch if isinstance(scratch, Path) else None
    with tempfile.TemporaryDirectory(prefix=".labyrinth-", dir=place) as folder:
        local = Path(folder) / path.name
        yield local
        if isinstance(path, Path):
            local.replace(path)
        else:
            path._ask(lambda store, place: store.put_file(str(local), place))

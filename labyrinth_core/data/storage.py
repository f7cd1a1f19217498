"""Files in a folder or in an object store: the few things that the pipeline does with them.

A local folder is a `pathlib.Path`. A URL that fsspec knows, such as `s3://bucket/data`, is a
`RemotePath`, which has those methods of `Path` that are needed here. What differs is said by the
functions: a local file comes by its name through a rename, a remote one by a single upload.
"""

from __future__ import annotations

import errno
import hashlib
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, BinaryIO, cast
from uuid import uuid4

from labyrinth_core.data.errors import one_line


def folder_at(place: str | Path) -> AnyPath:
    """Return the folder that a path or a URL means.

    Raises:
        ValueError: fsspec knows no such URL, or what it needs for it is not installed.
    """
    text = str(place)
    if text.startswith("file://"):
        return Path(text.removeprefix("file://"))
    if "://" not in text:
        return Path(place).expanduser()
    protocol = text.partition("://")[0]
    try:
        _filesystem(protocol)
    except ImportError as error:
        install = "pip install 'labyrinth-datasets[s3]'" if protocol == "s3" else one_line(error)
        raise ValueError(f"{text} needs a library that is missing: {install}") from error
    except Exception as error:  # Of any kind: each file system has its own way to start.
        raise ValueError(f"{text}: {one_line(error)}") from error
    return RemotePath(text.rstrip("/"))


@lru_cache(maxsize=8)
def _filesystem(protocol: str) -> Any:
    """Return the file system of a protocol; credentials are where its library looks for them."""
    import fsspec

    # A listing that is remembered would hide what other processes write.
    return fsspec.filesystem(protocol, use_listings_cache=False)


@contextmanager
def _os_errors(url: str) -> Iterator[None]:
    """Make an OSError, with the URL, of whatever a store raises within."""
    try:
        yield
    except FileNotFoundError:
        raise
    except Exception as error:  # Of any kind: each store has its own, such as botocore's.
        if isinstance(error, OSError) and error.filename:
            raise
        number = getattr(error, "errno", None) or errno.EIO
        reason = f"{type(error).__name__}: {one_line(error)}"
        raise OSError(number, reason, url) from error


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

    @property
    def _at(self) -> tuple[Any, str]:
        """The file system and the path in it."""
        filesystem = _filesystem(self.url.partition("://")[0])
        return filesystem, filesystem._strip_protocol(self.url)

    def exists(self) -> bool:
        filesystem, path = self._at
        with _os_errors(self.url):
            return bool(filesystem.exists(path))

    def is_dir(self) -> bool:
        filesystem, path = self._at
        with _os_errors(self.url):
            return bool(filesystem.isdir(path))

    def is_file(self) -> bool:
        filesystem, path = self._at
        with _os_errors(self.url):
            return bool(filesystem.isfile(path))

    def glob(self, pattern: str) -> Iterator[RemotePath]:
        filesystem, path = self._at
        with _os_errors(self.url):
            found = filesystem.glob(f"{path}/{pattern}")
        for each in sorted(found):
            yield self / each[len(path) + 1 :]

    def iterdir(self) -> Iterator[RemotePath]:
        return self.glob("*")

    def mkdir(self, *, parents: bool = False, exist_ok: bool = False) -> None:
        """Do nothing: an object store makes a folder with the first file in it."""

    def open(self, mode: str) -> BinaryIO:
        """Open for reading, mode "rb"."""
        filesystem, path = self._at
        with _os_errors(self.url):
            return cast("BinaryIO", filesystem.open(path, mode))

    def read_bytes(self) -> bytes:
        filesystem, path = self._at
        with _os_errors(self.url):
            return bytes(filesystem.cat_file(path))

    def read_text(self, encoding: str) -> str:
        return self.read_bytes().decode(encoding)

    def write_bytes(self, content: bytes) -> None:
        """Upload a file, whole or not at all."""
        filesystem, path = self._at
        with _os_errors(self.url):
            filesystem.pipe_file(path, content)

    def upload(self, local: Path) -> None:
        """Upload a local file under this name, whole or not at all."""
        filesystem, path = self._at
        with _os_errors(self.url):
            filesystem.put_file(str(local), path)

    def download(self, local: Path) -> None:
        """Copy the file to a local one."""
        filesystem, path = self._at
        with _os_errors(self.url):
            filesystem.get_file(path, str(local))

    def unlink(self, *, missing_ok: bool = False) -> None:
        filesystem, path = self._at
        with _os_errors(self.url):
            if not missing_ok or filesystem.exists(path):
                filesystem.rm_file(path)


AnyPath = Path | RemotePath


def write_bytes(path: AnyPath, content: bytes) -> None:
    """Write a file so that it is never half there."""
    if isinstance(path, RemotePath):
        path.write_bytes(content)
        return
    # Not the name that another process would use that makes the same file.
    temporary = path.with_name(f".{path.name}.{uuid4().hex[:12]}.tmp")
    try:
        temporary.write_bytes(content)
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


def write_text(path: AnyPath, text: str) -> None:
    """Write a text file so that it is never half there."""
    write_bytes(path, text.encode())


def file_sha256(path: AnyPath) -> str:
    """Return the SHA-256 of a file, in hexadecimal digits."""
    digest = hashlib.sha256()
    with path.open("rb") as file:
        while block := file.read(1 << 20):
            digest.update(block)
    return digest.hexdigest()


@contextmanager
def local_copy(path: AnyPath) -> Iterator[Path]:
    """Lend a local file with the content of a path: itself, or a download that is then removed."""
    if isinstance(path, Path):
        yield path
        return
    with tempfile.TemporaryDirectory(prefix="labyrinth-") as folder:
        local = Path(folder) / path.name
        path.download(local)
        yield local


@contextmanager
def new_file(path: AnyPath, scratch: AnyPath) -> Iterator[Path]:
    """Lend the name of a local file to be made; at the end it is moved or uploaded to a path.

    Args:
        path: Where it comes to lie, whole or not at all.
        scratch: Folder on the same disk, for a local path: a process that was given up may still
            be writing while another makes the same file, or moves its folder.
    """
    place = scratch if isinstance(scratch, Path) else None
    with tempfile.TemporaryDirectory(prefix=".labyrinth-", dir=place) as folder:
        local = Path(folder) / path.name
        yield local
        if isinstance(path, Path):
            local.replace(path)
        else:
            path.upload(local)

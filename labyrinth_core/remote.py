"""Files and folders in an object store: each file is uploaded whole, and nothing is renamed."""

from __future__ import annotations

import errno
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple, cast

from labyrinth_core.errors import naming, one_line


def filesystem(protocol: str) -> Any:
    """Return fsspec's shared file system of a protocol, whose library finds the credentials."""
    import fsspec

    if protocol == "hf":
        from labyrinth_core import hub

        hub.prepare_client()
    # A cached listing would hide what other processes write.
    return fsspec.filesystem(protocol, use_listings_cache=False)


class RemoteStatus(NamedTuple):
    """What a store says of a file, as in `os.stat_result`."""

    st_size: int
    """The size in bytes."""
    st_mtime: float
    """The modification time in seconds."""


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
            store = filesystem(self.url.partition("://")[0])
            path = store._strip_protocol(self.url)
            if not self.url.startswith("hf://"):
                return question(store, path)
            from labyrinth_core import hub

            try:
                return hub.repeated(lambda: question(store, path))
            except FileNotFoundError:  # Perhaps by a listing that came wrong, and is kept.
                store.invalidate_cache()
                return hub.repeated(lambda: question(store, path))
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
            base, entries = self._ask(lambda store, path: (path, store.ls(path, detail=True)))
        except FileNotFoundError:
            return []
        paths = {entry["name"].rstrip("/"): entry["type"] == "directory" for entry in entries}
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

    def write_bytes(self, content: bytes) -> None:
        """Write the file, whole or not at all."""
        self._ask(lambda store, path: store.pipe_file(path, content))

    def stat(self) -> RemoteStatus:
        """Return the size and the time of the file, without reading it."""
        size, written = self._ask(lambda store, path: (store.size(path), store.modified(path)))
        return RemoteStatus(int(size), written.timestamp())

    def download(self, local: Path) -> None:
        """Download the file to a local path."""
        self._ask(lambda store, path: store.get_file(path, str(local)))

    def upload(self, local: Path) -> None:
        """Upload a local file to this path."""
        self._ask(lambda store, path: store.put_file(str(local), path))

    def unlink(self, *, missing_ok: bool = False) -> None:
        if not missing_ok or self.exists():
            self._ask(lambda store, path: store.rm_file(path))


@dataclass(frozen=True)
class RemoteFile:
    """How a file or folder in a store is written, read and removed; see `storage.File`."""

    path: RemotePath

    def write_bytes(self, content: bytes) -> None:
        """Write the file in one upload."""
        self.path.write_bytes(content)

    @contextmanager
    def replacing(self, scratch: object = None) -> Iterator[Path]:  # noqa: ARG002
        """Yield a temporary local path, which is then uploaded."""
        with tempfile.TemporaryDirectory(prefix="labyrinth-") as folder:
            local = Path(folder) / self.path.name
            with naming(local):
                yield local
            self.path.upload(local)

    @contextmanager
    def local_copy(self) -> Iterator[Path]:
        """Yield the path of a temporary download."""
        with tempfile.TemporaryDirectory(prefix="labyrinth-") as folder:
            local = Path(folder) / self.path.name
            self.path.download(local)
            yield local

    @contextmanager
    def held(self, name: str, before_waiting: Callable[[], None]) -> Iterator[bool]:  # noqa: ARG002
        """Yield False: an object store has no locks."""
        yield False

    def names(self) -> list[str]:
        """Return the names of the files in the folder, which has no other folders."""
        return [path.name for path in self.path.iterdir()]

    def remove(self) -> None:
        """Remove the file."""
        self.path.unlink(missing_ok=True)

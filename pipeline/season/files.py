"""Files of strangers, read with limits, and temporary folders that only this user can read."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import gettempdir
from uuid import uuid4

from labyrinth_core.errors import DatasetError
from labyrinth_core.evaluation import Results
from labyrinth_core.storage import File, LocalFile
from pipeline.machinery.folders import held

_PREFIX = "labyrinth-season-"


def require_regular(path: Path, most: int) -> None:
    """Check a file before it is read.

    Args:
        path: The file, or a link to it.
        most: The maximum number of bytes.

    Raises:
        DatasetError: It is too large, or a device, a pipe or a folder.
        OSError: It does not exist.
    """
    size = path.stat().st_size
    if not path.is_file():
        raise DatasetError(f"{path} is not a regular file")
    if size > most:
        raise DatasetError(f"{path} has {size:,} bytes, more than {most:,}")


def has_sha256(path: Path, digest: str) -> bool:
    """Return whether a file exists, is not larger than any results or weights, and has a hash."""
    return (
        path.is_file() and path.stat().st_size <= Results.LARGEST and File(path).sha256() == digest
    )


@contextmanager
def private_folder() -> Iterator[Path]:
    """Yield a new temporary folder that only this user can read, and remove it at the end.

    Folders that killed processes of this user left are removed, too. A process holds the lock of
    its folder until it ends, however it ends.
    """
    base = Path(gettempdir())
    own = base / f"{_PREFIX}{uuid4().hex}"
    with held(base, own.name):
        own.mkdir(mode=0o700)
        try:
            for lock in base.glob(f".{_PREFIX}*.lock"):
                abandoned = base / lock.name.removeprefix(".").removesuffix(".lock")
                with suppress(OSError):  # Its process is alive and holds it, or has just ended.
                    if abandoned != own and lock.lstat().st_uid == own.lstat().st_uid:
                        with LocalFile(lock).locked(wait=False):
                            File(abandoned).remove()
            yield own
        finally:
            File(own).remove()

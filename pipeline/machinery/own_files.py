"""The files that stages leave in a person's folder, told from the files of that person.

`SHA256SUMS` lists what was left, with hashes. A file that it does not list, or lists with another
hash, belongs to the user: it is neither written over, nor removed, nor published. What is made of
many files, a dataset or an export, is replaced as a whole, unless it holds a file of a user.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path, PurePath

from labyrinth_core.data.errors import DatasetError
from labyrinth_core.data.storage import (
    AnyPath,
    file_sha256,
    temporaries,
    write_bytes,
    write_text,
)
from pipeline.machinery.folders import held

HASHES = "SHA256SUMS"
"""The name of the list, which `sha256sum -c` reads."""

_LITTER = (
    *(".ds_store", "._*", "thumbs.db", "desktop.ini", ".directory"),
    *(".nfs*", ".fuse_hidden*"),
    *(".ipynb_checkpoints", "cache-*.arrow"),
)
"""Patterns, in lower case, of files and folders that desktops, network file systems and readers
(Jupyter, `datasets`) leave anywhere."""

_LINE = re.compile(r"([0-9a-f]{64})  (\S.*)")


def is_litter(path: str | PurePath) -> bool:
    """Return whether a path within a folder is that of a file that nobody misses: see `_LITTER`."""
    parts = [part.lower() for part in PurePath(path).parts]
    return any(fnmatchcase(part, pattern) for part in parts for pattern in _LITTER)


@dataclass(frozen=True)
class OwnFiles:
    """The files that were left in a folder."""

    folder: AnyPath
    hashes: frozenset[tuple[str, str]]
    """Name and SHA-256 of each file; for a moment, while files are replaced, of old and new."""

    @classmethod
    def read(cls, folder: AnyPath, always: str) -> OwnFiles:
        """Return the files that the list in a folder names, none where there is no list.

        Args:
            folder: The folder.
            always: A pattern of the name of a file that every list of this folder names.

        Raises:
            DatasetError: There is a list that no stage made.
        """
        path = folder / HASHES
        try:
            text = path.read_bytes().decode(errors="replace")
        except (FileNotFoundError, NotADirectoryError):
            return cls(folder, frozenset())
        lines = [_LINE.fullmatch(line) for line in text.splitlines()]
        hashes = frozenset((line[2], line[1]) for line in lines if line)
        if None in lines or not any(re.fullmatch(always, name) for name, _ in hashes):
            raise DatasetError(f"{path} is somebody else's: move it away, or choose another folder")
        return cls(folder, hashes)

    def has(self, name: str) -> bool:
        """Return whether a file is there as it was left."""
        path = self.folder / name
        return path.is_file() and (name, file_sha256(path)) in self.hashes

    def others(self, files: Mapping[str, bytes]) -> list[str]:
        """Return the names at which files would be written over a user's."""

        def is_free(name: str, content: bytes) -> bool:
            path = self.folder / name
            if not path.is_file():
                return not path.exists()
            return self.has(name) or path.read_bytes() == content

        return [name for name, content in files.items() if not is_free(name, content)]

    def refuse_others(self, files: Mapping[str, bytes]) -> None:
        """Raise DatasetError if files would be written over a user's."""
        if others := self.others(files):
            names = ", ".join(str(self.folder / name) for name in others[:3])
            more = f" and {len(others) - 3} more" if len(others) > 3 else ""
            raise DatasetError(
                f"{names}{more}: made or changed by somebody else, so not written over; move it "
                "away, or choose another folder"
            )

    def unfinished(self, names: Iterable[str]) -> list[Path]:
        """Return what killed processes left that were writing files of these names."""
        if not isinstance(self.folder, Path):
            return []
        return [left for name in names for left in temporaries(self.folder / name)]

    def replace(self, files: Mapping[str, bytes], gone: Iterable[str]) -> OwnFiles:
        """Write files, remove others that were left, and return the files that are left now.

        Meanwhile the list names old and new ones; the caller then writes the final one.

        Args:
            files: The content of each, by name.
            gone: The names of files that are not to be there any more.
        """
        new = {(name, hashlib.sha256(content).hexdigest()) for name, content in files.items()}
        self.folder.mkdir(parents=True, exist_ok=True)
        for left in self.unfinished([*files, HASHES]):
            left.unlink()
        write_list(self.folder, self.hashes | new)
        for name in gone:
            if self.has(name):
                (self.folder / name).unlink()
        for name, content in files.items():
            path = self.folder / name
            path.parent.mkdir(parents=True, exist_ok=True)
            write_bytes(path, content)
        kept = {(name, digest) for name, digest in self.hashes - new if self.has(name)}
        return OwnFiles(self.folder, frozenset(kept | new))


def write_list(folder: AnyPath, hashes: Iterable[tuple[str, str]]) -> None:
    """Write the list of the files that were left in a folder: pairs of name and SHA-256."""
    lines = (f"{digest}  {name}\n" for name, digest in sorted(hashes))
    write_text(folder / HASHES, "".join(lines))


def leave(folder: AnyPath, files: Mapping[str, bytes], always: str) -> None:
    """Write files into a folder, in place of those that were left there before.

    Args:
        folder: The folder, which is made.
        files: The content of each, by name.
        always: As for `OwnFiles.read`.

    Raises:
        DatasetError: A file of a user is in the place of one; nothing is written.
        OSError: The folder cannot be written.
    """
    place = folder.absolute() if isinstance(folder, Path) else folder
    with held(place.parent, place.name):
        own = OwnFiles.read(folder, always)
        own.refuse_others(files)
        write_list(folder, own.replace(files, gone=()).hashes)


def list_all(folder: Path) -> None:
    """Write the list of all files of a folder that holds nothing else."""
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    names = (path.relative_to(folder).as_posix() for path in files)
    write_list(folder, zip(names, map(file_sha256, files), strict=True))

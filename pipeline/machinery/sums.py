"""The record of a folder's files that the program wrote ("ours"), and of what they are made from.

`SHA256SUMS` lists them in the format of `sha256sum -c`. Its comments hold the key, which is the
inputs that determine the files, and, except in a release, a hash of the list itself. A file that is
not listed, or has another hash, belongs to the user.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from difflib import get_close_matches
from typing import Any

from labyrinth_core.errors import DatasetError
from labyrinth_core.folders import WholeFolder
from labyrinth_core.storage import AnyPath, File

HASHES = "SHA256SUMS"
"""The name of the list."""

Key = Mapping[str, Any]
"""The inputs that determine an artifact, in JSON types."""

_OURS, _MADE, _LEFT = "# labyrinth-datasets", "# made from ", "# left beside it"
_ITSELF = "# sha256 of the lines below "
_LINE = re.compile(r"^([0-9a-f]{64})  (?![/\\]|\w:|.*\.\.[/\\])(\S.*)$", re.M)  # Inside the folder.
_KEY = re.compile(f"^{_MADE}(.*)$", re.M)

UNKNOWN = "0" * 64
"""Stands for the hash of a file in a store that is not made yet."""


@dataclass(frozen=True)
class Sums:
    """The files of a folder that are ours, as pairs of name and SHA-256."""

    folder: AnyPath
    key: Key | None = None
    """The inputs that the folder is made from; None if unknown."""
    made: frozenset[tuple[str, str]] = frozenset()
    """The artifact's own files; without one of them it is damaged."""
    left: frozenset[tuple[str, str]] = frozenset()
    """Other files that stages have written there; during a replacement, old and new ones."""
    is_damaged: bool = False
    """Whether the list is damaged, so that it does not show which files the artifact has."""

    @classmethod
    def read(cls, folder: AnyPath, *, overwrite: bool = False) -> Sums:
        """Read the list of a folder; without a list, no file is ours.

        Args:
            folder: The folder.
            overwrite: Whether to use the readable lines of a damaged list, which is replaced.

        Raises:
            DatasetError: The list is damaged, or another program wrote it.
        """
        path = folder / HASHES
        try:
            text = path.read_bytes().decode(errors="replace")
        except (FileNotFoundError, NotADirectoryError) as error:
            if path.is_symlink():
                raise DatasetError(f"{path} is a link that leads nowhere: remove it") from error
            return cls(folder)
        parts = text.partition(f"{_LEFT}\n")[::2]
        made, left = (frozenset((n, digest) for digest, n in _LINE.findall(p)) for p in parts)
        key = None
        with suppress(ValueError, RecursionError):
            key = next(map(json.loads, _KEY.findall(text)), None)
        sums = cls(folder, key if isinstance(key, dict) else None, made, left)
        lines = sorted(sums._text(with_hash=False).splitlines())
        is_whole = text == sums._text() or (sorted(text.splitlines()) == lines)
        if is_whole and text.endswith("\n") and (sums.hashes or key):
            return sums
        first = text[: len(_OURS)].strip("\0")
        if not (_OURS.startswith(first) or get_close_matches(first, [_OURS])):
            advice = "move it away, or choose another folder"
            raise DatasetError(f"{path} is another program's: {advice}")
        if not overwrite:
            again = "the stage that made its files makes them again with overwrite=true"
            raise DatasetError(f"{path} is damaged: {again}; or move {folder} away")
        return replace(sums, is_damaged=True)

    @classmethod
    def of(cls, folder: AnyPath, key: Key | None = None, names: Sequence[str] = ()) -> Sums:
        """Hash all files of a folder; those in `names`, by default all, count as `made`."""
        hashes = {(n, File(folder / n).sha256()) for n in File(folder).names() if n != HASHES}
        made = frozenset(each for each in hashes if not names or each[0] in names)
        return cls(folder, key, made, frozenset(hashes - made))

    def write(self) -> None:
        """Write the list atomically."""
        File(self.folder / HASHES).write_bytes(self.content())

    def content(self) -> bytes:
        """Return the content of the list."""
        return self._text().encode()

    def _text(self, *, with_hash: bool = True) -> str:
        """Return the list, with a hash of itself; those of releases and old versions have none."""
        lines = [] if self.key is None else [_MADE + json.dumps(self.key)]
        lines += [f"{digest}  {name}" for name, digest in sorted(self.made)]
        if self.left:
            lines += [_LEFT, *(f"{digest}  {name}" for name, digest in sorted(self.left))]
        rest = "".join(f"{line}\n" for line in lines)
        if with_hash and (self.key is not None or self.left):
            rest = f"{_ITSELF}{hashlib.sha256(rest.encode()).hexdigest()}\n{rest}"
        return f"{_OURS}\n{rest}"

    @property
    def hashes(self) -> frozenset[tuple[str, str]]:
        """The files that are ours."""
        return self.made | self.left

    def has(self, name: str) -> bool:
        """Return whether a file exists with a hash that is listed."""
        return (name, hash_of(self.folder / name)) in self.hashes

    def damaged(self) -> list[str]:
        """Return the files in `made` that are missing or have another hash.

        In a store, where hashing means a download, a file older than the list is taken for whole,
        unless stages left others there, so rewrote the list.
        """
        whole = WholeFolder.of(self.folder, HASHES)

        def is_whole(name: str, digest: str) -> bool:
            path = self.folder / name
            if not self.left and digest != UNKNOWN and path.is_file():
                return whole.is_covered(File(path).size_and_time()[1]) or self.has(name)
            return self.has(name)

        return sorted(name for name, digest in self.made if not is_whole(name, digest))


def hash_of(path: AnyPath) -> str | None:
    """Return the SHA-256 of a file; None if it does not exist."""
    return File(path).sha256() if path.is_file() else None

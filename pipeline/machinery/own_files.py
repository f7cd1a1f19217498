"""The files that stages leave in a person's folder, told from the files of that person.

`SHA256SUMS` lists what was left, with hashes. A file that it does not list, or lists with another
hash, belongs to the user: it is neither written over, nor removed, nor published.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from labyrinth_core.data.errors import DatasetError
from labyrinth_core.data.storage import AnyPath, file_sha256, write_bytes, write_text

HASHES = "SHA256SUMS"
"""The name of the list, which `sha256sum -c` reads."""

_LINE = re.compile(r"([0-9a-f]{64})  (\S.*)")


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
        except FileNotFoundError:
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

    def replace(self, files: Mapping[str, bytes], gone: Iterable[str]) -> OwnFiles:
        """Write files, remove others that were left, and return the files that are left now.

        Meanwhile the list names old and new ones; the caller then writes the final one.

        Args:
            files: The content of each, by name.
            gone: The names of files that are not to be there any more.
        """
        new = {(name, hashlib.sha256(content).hexdigest()) for name, content in files.items()}
        write_list(self.folder, self.hashes | new)
        for name in gone:
            if self.has(name):
                (self.folder / name).unlink()
        for name, content in files.items():
            write_bytes(self.folder / name, content)
        kept = {(name, digest) for name, digest in self.hashes - new if self.has(name)}
        return OwnFiles(self.folder, frozenset(kept | new))


def write_list(folder: AnyPath, hashes: Iterable[tuple[str, str]]) -> None:
    """Write the list of the files that were left in a folder: pairs of name and SHA-256."""
    lines = (f"{digest}  {name}\n" for name, digest in sorted(hashes))
    write_text(folder / HASHES, "".join(lines))

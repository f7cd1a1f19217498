"""The contents of files, each stored once under its SHA-256, and unfinished uploads."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from pathlib import Path
from uuid import uuid4

from hub.xet_store import XetStore


class BrokenUploadError(ValueError):
    """What was sent is not what was announced."""


class Blobs:
    """Contents in `blobs/`, parts of large ones in `parts/`, and hf-xet's store beside them."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder / "blobs"
        self.parts = folder / "parts"
        self.xet = XetStore(folder / "xet")
        for path in (self.folder, self.parts, self.xet.folder):
            path.mkdir(parents=True, exist_ok=True)

    def path(self, sha256: str) -> Path:
        """Return where a content is, or would be."""
        return self.folder / sha256

    def has(self, sha256: str, size: int | None = None) -> bool:
        """Return whether a content is here, fetching it from hf-xet's store if it is there."""
        path = self.path(sha256)
        if not path.exists() and (file := self.xet.find(sha256)):
            self.receive(sha256, [self.xet.read(file)])
        return path.exists() and size in (None, path.stat().st_size)

    def xet_hash(self, sha256: str) -> str | None:
        """Return Xet's name of a content, None if it did not come through Xet."""
        file = self.xet.find(sha256)
        return file.xet_hash if file else None

    def add(self, content: bytes) -> str:
        """Return the SHA-256 of a content, which is stored."""
        sha256 = hashlib.sha256(content).hexdigest()
        self.receive(sha256, [content])
        return sha256

    def read(self, sha256: str) -> bytes:
        """Return a content."""
        return self.path(sha256).read_bytes()

    def receive(self, sha256: str, chunks: Iterable[bytes]) -> None:
        """Store a content that comes in pieces; if the last never comes, nothing is stored.

        Raises:
            BrokenUploadError: if it has another hash than the one announced.
        """
        found = hashlib.sha256()
        unfinished = self.parts / uuid4().hex
        try:
            with unfinished.open("wb") as file:
                for chunk in chunks:
                    found.update(chunk)
                    file.write(chunk)
            if found.hexdigest() != sha256:
                raise BrokenUploadError(f"sha256 is {found.hexdigest()}; announced was {sha256}")
            unfinished.replace(self.path(sha256))
        finally:
            unfinished.unlink(missing_ok=True)

    def begin_parts(self) -> str:
        """Return the name of a new upload in parts."""
        name = uuid4().hex
        (self.parts / name).mkdir()
        return name

    def receive_part(self, upload: str, number: int, content: bytes) -> str:
        """Return the ETag of a part, which is stored."""
        (self.parts / upload / f"{number:05d}").write_bytes(content)
        return hashlib.md5(content).hexdigest()

    def join_parts(self, upload: str, sha256: str, etags: list[str]) -> None:
        """Store the content whose parts have these ETags, in that order.

        Raises:
            BrokenUploadError: if a part is missing or another one, or the whole is.
        """
        folder = self.parts / upload
        parts = sorted(folder.glob("*"))
        contents = [part.read_bytes() for part in parts]
        found = [hashlib.md5(content).hexdigest() for content in contents]
        if found != etags:
            raise BrokenUploadError(f"parts have ETags {found}; announced were {etags}")
        self.receive(sha256, contents)
        for part in parts:
            part.unlink()
        folder.rmdir()

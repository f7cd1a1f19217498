"""Reading what hf-xet has written to its own store on disk (`casUrl: "local://FOLDER"`).

The client tells the Hub only the SHA-256 of a file it sent to Xet, so the Hub looks the file up
in the shards, and puts it together from the xorbs. hf-xet locks the store's index while it works,
not these files. Layout and formats: those of hf-xet 1.8, described at
https://huggingface.co/docs/xet (shard and xorb format).
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from hub.lz4 import decompress

SHARDS = Path("xet/xorbs/shards")
XORBS = Path("xet/xorbs/xorbs")
HEADER_SIZE = 48
RECORD_SIZE = 48
BOOKEND = b"\xff" * 32
WITH_VERIFICATION, WITH_METADATA = 1 << 31, 1 << 30
FOOTER = b"XETBLOB"
STORED, LZ4, GROUPED_LZ4 = range(3)


class XetStoreError(RuntimeError):
    """The store does not hold what its shards say."""


@dataclass(frozen=True)
class Segment:
    """A run of chunks of a xorb."""

    xorb: str
    size: int
    start: int
    stop: int


@dataclass(frozen=True)
class StoredFile:
    """A file in the store."""

    xet_hash: str
    sha256: str
    segments: tuple[Segment, ...]

    @property
    def size(self) -> int:
        """The number of bytes of the file."""
        return sum(segment.size for segment in self.segments)


@dataclass(frozen=True)
class XetStore:
    """hf-xet's store in a folder."""

    folder: Path

    @property
    def url(self) -> str:
        """What hf-xet takes for the address of this store."""
        return f"local://{self.folder}"

    def find(self, sha256: str) -> StoredFile | None:
        """Return the file with that hash, or None if it is not (yet) wholly in the store."""
        for shard in sorted((self.folder / SHARDS).glob("*.mdb")):
            for file in _files(shard.read_bytes()):
                if file.sha256 == sha256:
                    return file
        return None

    def read(self, file: StoredFile) -> bytes:
        """Return the content of a file.

        Raises:
            XetStoreError: if a xorb is missing or shorter than the shard says.
        """
        return b"".join(self._read_segment(segment) for segment in file.segments)

    def size(self) -> int:
        """Return the number of bytes in the store: it stays the same if nothing new is sent."""
        xorbs = (self.folder / XORBS).glob(f"default.{'?' * 64}")
        return sum(path.stat().st_size for path in xorbs)

    def _read_segment(self, segment: Segment) -> bytes:
        path = self.folder / XORBS / f"default.{segment.xorb}"
        try:
            chunks = list(_chunks(path.read_bytes(), segment.stop))
        except FileNotFoundError as error:
            raise XetStoreError(f"xorb {segment.xorb} is not in the store") from error
        content = b"".join(chunks[segment.start :])
        if len(content) != segment.size:
            raise XetStoreError(
                f"xorb {segment.xorb} has {len(content)} bytes in chunks {segment.start} to"
                f" {segment.stop}, not {segment.size}"
            )
        return content


def _files(shard: bytes) -> Iterator[StoredFile]:
    """Yield the files of a shard: the file section begins after the header, up to a bookend."""
    position = HEADER_SIZE
    while shard[position : position + 32] not in (BOOKEND, b""):
        xet_hash = _hash(shard, position)
        flags, count = struct.unpack_from("<II", shard, position + 32)
        position += RECORD_SIZE
        segments = []
        for _ in range(count):
            _, size, start, stop = struct.unpack_from("<IIII", shard, position + 32)
            segments.append(Segment(_hash(shard, position), size, start, stop))
            position += RECORD_SIZE
        if flags & WITH_VERIFICATION:
            position += count * RECORD_SIZE
        if flags & WITH_METADATA:
            yield StoredFile(xet_hash, _hash(shard, position), tuple(segments))
            position += RECORD_SIZE


def _hash(shard: bytes, position: int) -> str:
    """Return a hash as Xet writes it: four little-endian words in hexadecimal."""
    return "".join(f"{word:016x}" for word in struct.unpack_from("<4Q", shard, position))


def _chunks(xorb: bytes, count: int) -> Iterator[bytes]:
    """Yield the first `count` chunks: version, length, scheme, uncompressed length, then data."""
    position = 0
    for _ in range(count):
        if position >= len(xorb) or xorb[position : position + len(FOOTER)] == FOOTER:
            return
        length = int.from_bytes(xorb[position + 1 : position + 4], "little")
        scheme = xorb[position + 4]
        position += 8
        data = xorb[position : position + length]
        position += length
        yield data if scheme == STORED else _expand(decompress(data), scheme)


def _expand(content: bytes, scheme: int) -> bytes:
    """Return the content of a compressed chunk; one scheme keeps every fourth byte together."""
    if scheme == LZ4:
        return content
    if scheme != GROUPED_LZ4:
        raise XetStoreError(f"chunk is compressed by scheme {scheme}; known are 0, 1 and 2")
    spread = bytearray(len(content))
    position = 0
    for group in range(4):
        size = len(range(group, len(content), 4))
        spread[group::4] = content[position : position + size]
        position += size
    return bytes(spread)

"""The fingerprint of a dataset: a hash of values and pixels, independent of their compression.

It tells whether two datasets have the same content. It does not protect against forgery; the
SHA-256 of each file in the manifest does.
"""

from __future__ import annotations

import hashlib
import struct
from collections.abc import Sequence
from typing import NamedTuple

_NUMBERS = struct.Struct("<qf?")


class Row(NamedTuple):
    """One state of an episode, in the dataset's columns."""

    obs: bytes
    """The picture as a PNG file."""
    obs_path: str
    """The name of the picture, unique in its config."""
    actions: int
    rewards: float
    episode_starts: bool
    info: str
    picture_digest: bytes
    """The digest of its pixels, which is not a column."""


class Fingerprint:
    """A hash of the values and pixels of rows, in their order.

    It is the SHA-256 of this for each row: the picture's digest, `actions` as int64, `rewards` as
    float32, `episode_starts` as one byte (all little-endian), and the BLAKE2b hash of `info` in
    UTF-8, sixteen bytes.
    """

    def __init__(self) -> None:
        self._hash = hashlib.sha256()

    def update(self, rows: Sequence[Row]) -> None:
        """Add rows."""
        infos = {row.info for row in rows}
        texts = {info: hashlib.blake2b(info.encode(), digest_size=16).digest() for info in infos}
        parts = [
            digest + _NUMBERS.pack(action, reward, starts) + texts[info]
            for _, _, action, reward, starts, info, digest in rows
        ]
        self._hash.update(b"".join(parts))

    def hexdigest(self) -> str:
        """Return the hash of the rows so far, in hexadecimal digits."""
        return self._hash.hexdigest()

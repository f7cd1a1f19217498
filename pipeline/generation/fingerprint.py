"""The fingerprint of a dataset: a hash of values and pixels, independent of their compression.

It tells whether two datasets have the same content. It does not protect against forgery; the
SHA-256 of each file in the manifest does.
"""

from __future__ import annotations

import hashlib
import struct
from collections.abc import Mapping, Sequence
from functools import lru_cache
from operator import mul
from typing import NamedTuple

from labyrinth_core.pictures.png import Strip

_MODULUS = 2**127 - 1
_BASE = 0x4F1BBCDCBFA53E0AF9CE60302E76E41A
"""Digits of half the golden ratio, which are arbitrary but not chosen."""
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
        texts = {info: _hash(info.encode()) for info in {row.info for row in rows}}
        parts = [
            digest + _NUMBERS.pack(action, reward, starts) + texts[info]
            for _, _, action, reward, starts, info, digest in rows
        ]
        self._hash.update(b"".join(parts))

    def hexdigest(self) -> str:
        """Return the hash of the rows so far, in hexadecimal digits."""
        return self._hash.hexdigest()


def _hash(content: bytes) -> bytes:
    return hashlib.blake2b(content, digest_size=16).digest()


class PictureDigest:
    """The digest of the pixels of a picture, sixteen bytes, and of it with strips exchanged.

    The digest is the value of a polynomial at a fixed base, modulo 2**127 - 1. Its coefficients are
    the BLAKE2b hashes of the rows of pixels, sixteen bytes each; the lowest row's is the constant
    term (Karp and Rabin, 1987). As it is a sum, a change of a row changes one summand.
    """

    def __init__(self, strips: Sequence[Strip]) -> None:
        """Take the picture with nothing exchanged."""
        sums_and_heights = [_strip_sum(strip) for strip in strips]
        self._sums = [strip_sum for strip_sum, _ in sums_and_heights]
        self._powers = _powers(tuple(height for _, height in sums_and_heights))
        self._sum: int = sum(map(mul, self._sums, self._powers))

    def digest(self, changes: Mapping[int, Strip]) -> bytes:
        """Return the digest with strips, counted from the top, exchanged for as high ones."""
        total = self._sum
        for place, strip in changes.items():
            total += (_strip_sum(strip)[0] - self._sums[place]) * self._powers[place]
        return (total % _MODULUS).to_bytes(16, "little")


@lru_cache(maxsize=64)
def _powers(heights: tuple[int, ...]) -> list[int]:
    """Return the factor of each strip: the base to the power of the number of rows below it."""
    powers = [1]
    for height in heights[:0:-1]:
        powers.append(powers[-1] * _repeated(height)[1] % _MODULUS)
    return powers[::-1]


# Without the cache of `_strip_sum` or `_repeated` the build writes 0.7 or 0.6 times as many rows a
# second at 5x5; without that of `_row_hash` 0.96 times as many at 25x25.


@lru_cache(maxsize=8_192)
def _strip_sum(strip: Strip) -> tuple[int, int]:
    """Return the sum of a strip at the bottom of a picture, and the strip's height."""
    total = height = 0
    for row, count in strip:
        repeated, power = _repeated(count)
        total = (total * power + _row_hash(row) * repeated) % _MODULUS
        height += count
    return total, height


@lru_cache(maxsize=8_192)
def _row_hash(row: bytes) -> int:
    return int.from_bytes(_hash(row), "little")


@lru_cache(maxsize=1_024)
def _repeated(count: int) -> tuple[int, int]:
    """Return the factors of a row that comes `count` times, and of all that is above it.

    They are the sum of the powers of the base below `count`, and the power `count`.
    """
    power = pow(_BASE, count, _MODULUS)
    return (power - 1) * pow(_BASE - 1, -1, _MODULUS) % _MODULUS, power

"""The fingerprint of a dataset's content: of values and pixels, whatever compressed them.

It says whether two datasets hold the same. It is not meant to stop a forger; the SHA-256 of each
file, beside it in the manifest, is.
"""

from __future__ import annotations

import hashlib
import struct
from collections.abc import Mapping, Sequence
from functools import lru_cache
from operator import mul

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.data.columns import Row
from labyrinth_core.pictures.png import Strip

_MODULUS = 2**127 - 1
_BASE = 0x4F1BBCDCBFA53E0AF9CE60302E76E41A
"""Half the golden ratio's digits: as good as random, and nobody's choice."""
_NUMBERS = struct.Struct("<qf?")


class Fingerprint:
    """A hash over the values and pixels of rows, in their order.

    SHA-256 of this, for each row: the picture's digest, `actions` as int64, `rewards` as float32,
    `episode_starts` as one byte (all little-endian), and the BLAKE2b hash of `info` in UTF-8,
    sixteen bytes.
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


def picture_digest(strips: Sequence[Strip]) -> bytes:
    """Return sixteen bytes that depend on the pixels of a picture and on nothing else.

    They are a polynomial, modulo 2**127 - 1, in a fixed number: its coefficients are the BLAKE2b
    hashes of the rows of pixels, sixteen bytes each, the lowest row's without a power. Strings
    hashed so are told apart (Karp and Rabin, 1987) and, as the hash is a sum, a row that changes
    changes one summand.
    """
    return PictureDigest(strips).digest({})


class PictureDigest:
    """The digest of a picture of which some strips are exchanged; see `picture_digest`."""

    def __init__(self, strips: Sequence[Strip]) -> None:
        """Take the picture with nothing exchanged."""
        heights: tuple[int, ...]
        self._sums: tuple[int, ...]
        self._sums, heights = zip(*map(_strip_sum, strips), strict=True)
        self._powers = _powers(heights)
        self._sum: int = sum(map(mul, self._sums, self._powers))

    def digest(self, changes: Mapping[int, Strip]) -> bytes:
        """Return the digest of the picture with some strips exchanged.

        Args:
            changes: Place of a strip, counted from the top -> one of the same height.
        """
        total = self._sum
        for place, strip in changes.items():
            total += (_strip_sum(strip)[0] - self._sums[place]) * self._powers[place]
        return (total % _MODULUS).to_bytes(16, "little")


@lru_cache(maxsize=64)
def _powers(heights: tuple[int, ...]) -> list[int]:
    """Return what is multiplied with the sum of each strip, by the rows that lie below it."""
    powers = [1]
    for height in heights[:0:-1]:
        powers.append(powers[-1] * _repeated(height)[1] % _MODULUS)
    return powers[::-1]


# Without the cache of `_strip_sum` or `_repeated` the build writes 0.7 or 0.6 times as many rows a
# second at 5x5.


@lru_cache(maxsize=8_192)
def _strip_sum(strip: Strip) -> tuple[int, int]:
    """Return the sum of a strip that lies at the bottom, and its height."""
    total = height = 0
    for row, count in strip:
        repeated, power = _repeated(count)
        total = (total * power + int.from_bytes(_hash(row), "little") * repeated) % _MODULUS
        height += count
    return total, height


@lru_cache(maxsize=1_024)
def _repeated(count: int) -> tuple[int, int]:
    """Return the factors of a row that comes `count` times, and of all that is above it.

    They are the sum of the powers of the base below `count`, and the power `count`.
    """
    power = pow(_BASE, count, _MODULUS)
    return (power - 1) * pow(_BASE - 1, -1, _MODULUS) % _MODULUS, power


def decoded_picture_digest(picture: NDArray[np.uint8]) -> bytes:
    """Return the digest of a decoded picture, shape (height, width, 3)."""
    differs = (picture[1:] != picture[:-1]).any(axis=(1, 2))
    first = np.flatnonzero(np.concatenate(([True], differs)))
    counts = np.diff(first, append=len(picture)).tolist()
    bands = zip((row.tobytes() for row in picture[first]), counts, strict=True)
    return picture_digest([(band,) for band in bands])

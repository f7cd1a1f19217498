"""Write and read PNG files quickly, for pictures made of few distinct rows of pixels.

General encoders and decoders process every pixel, which takes milliseconds per picture. Here a
picture is a sequence of strips. A strip is a few rows of pixels, each with its number of
repetitions; it is compressed once, ends with a full flush so that it stands alone, and is cached.
A picture is its strips joined, and its Adler-32 follows from theirs, so exchanging strips costs
only the new ones. A repeated row is the filter "up" over zeros, whatever its pixels, so its
compressed form depends only on the length, and a new strip costs one row of pixels. Reading unpacks
each distinct row once. The digest of a picture's pixels is computed from its rows in the same way.

Pictures are truecolour, 8 bits per channel (colour type 2), so that every reader sees three
channels. Format: PNG, https://www.w3.org/TR/png-3/; deflate, RFC 1951; Adler-32, RFC 1950.
"""

from __future__ import annotations

import hashlib
import struct
import zlib
from collections.abc import Mapping, Sequence
from functools import lru_cache
from itertools import accumulate
from operator import mul
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

PICTURE_SIZE = 600
"""Pixels on each side of the pictures in the datasets."""

DEFAULT_IMAGE_SIZE = 64
"""Pixels on each side of the images that the benchmark's baselines see (supplement, section 1)."""

Band = tuple[bytes, int]
"""A row of pixels, three bytes each, and how many times it is repeated."""

Strip = tuple[Band, ...]
"""Bands, from top to bottom."""


class KeptStrip(Strip):
    """A strip that is drawn once and used in many pictures; caches compare it by identity."""

    __slots__ = ()
    __hash__ = object.__hash__
    __eq__ = object.__eq__


LEVEL = 3
"""The zlib level for rows of pixels, most of which occur in only one picture.

Another level would change the bytes of every picture, though not its pixels.
"""
REPEAT_LEVEL = 9
"""The zlib level for repeated rows, which are most of a picture and the same in all pictures."""

ENCODER = f"own encoder, deflate levels {LEVEL} and {REPEAT_LEVEL}"
"""What determines the bytes of a picture besides zlib, as manifests name it."""

_WINDOW_BITS, _MEMORY_LEVEL = -12, 5
_ADLER_MODULUS = 65_521
_FILTER_NONE = b"\x00"
_FILTER_UP = b"\x02"
_DATA_START = b"IDAT\x78\x01"
"""The name of the chunk with the data, and the header of zlib (RFC 1950, section 2.2)."""
_FLUSH = b"\x00\x00\xff\xff"
"""The end of a full flush: the length of an empty stored block (RFC 1951, section 3.2.4)."""
_LAST_BLOCK = b"\x03\x00"
"""An empty deflate block marked as the last."""
_NUMBER, _SUMS = struct.Struct(">I"), struct.Struct(">HH")

_DIGEST_MODULUS = 2**127 - 1
_DIGEST_BASE = 0x4F1BBCDCBFA53E0AF9CE60302E76E41A
"""Digits of half the golden ratio, an arbitrary number that was not picked for a purpose."""


class Piece(NamedTuple):
    """Compressed bytes that can be decompressed on their own."""

    compressed: bytes
    a: int
    b: int
    """The two sums of Adler-32."""
    length: int
    """Bytes uncompressed."""


def encode(strips: Sequence[Strip], width: int) -> bytes:
    """Return the PNG file of a picture.

    Args:
        strips: The picture from top to bottom; every row has `3 * width` bytes.
        width: The number of pixels in a row.
    """
    return Mosaic(strips, width).encode({})


class Mosaic:
    """A picture that is encoded with some strips exchanged, at the cost of only those strips."""

    def __init__(self, strips: Sequence[Strip], width: int) -> None:
        """Compress the picture as it is; the arguments are those of the function `encode`."""
        self._pieces = list(map(_strip_piece, strips))
        self._below, *self._sums = _sums(self._pieces)
        self._parts = [_DATA_START, *[piece[0] for piece in self._pieces]]
        self._header = _header(width, (self._below[0] + self._pieces[0].length) // (3 * width + 1))

    def encode(self, changes: Mapping[int, Strip]) -> bytes:
        """Return the PNG file of the picture with some strips exchanged.

        Args:
            changes: Index of a strip, counted from the top -> its replacement, of the same height.

        Raises:
            ValueError: A replacement has another height.
        """
        parts = self._parts.copy()
        a, b = self._sums
        for index, strip in changes.items():
            compressed, new_a, new_b, new_length = _strip_piece(strip)
            _, old_a, old_b, old_length = self._pieces[index]
            if new_length != old_length:
                raise ValueError(f"strip {index}: {new_length} bytes of rows, not {old_length}")
            a += new_a - old_a
            b += new_b - old_b + (new_a - old_a) * self._below[index]
            parts[index + 1] = compressed
        parts.append(_LAST_BLOCK)
        parts.append(_SUMS.pack(b % _ADLER_MODULUS, a % _ADLER_MODULUS))
        return _file(self._header, b"".join(parts))


def strips_in(picture: NDArray[np.uint8]) -> list[Strip]:
    """Split a picture of shape (height, width, 3) into strips of a single band each."""
    differs = (picture[1:] != picture[:-1]).any(axis=(1, 2))
    first = np.flatnonzero(np.concatenate(([True], differs)))
    counts = np.diff(first, append=len(picture)).tolist()
    return [((picture[row].tobytes(), count),) for row, count in zip(first, counts, strict=True)]


def strips_of(png: bytes, size: int) -> list[Strip] | None:
    """Return the strips of a PNG file made by `encode`, each a single band.

    Args:
        png: The file.
        size: The pixels on each side of the picture.

    Returns:
        None for any other file: of another size or encoder, damaged, or not a PNG.
    """
    header, stride = _header(size, size), 3 * size + 1
    chunk = png[len(header) + 4 : -len(_END) - 4]
    *parts, last = chunk[len(_DATA_START) : -4].split(_FLUSH)
    if not parts or not chunk.startswith(_DATA_START) or last != _LAST_BLOCK:
        return None
    if png != _file(header, chunk):
        return None
    pieces: list[Piece] = []
    bands: list[Band] = []
    for part in parts:
        unpacked = _unpack(part + _FLUSH, stride, size)
        if unpacked is None:
            return None
        row, piece = unpacked
        pieces.append(piece)
        if row:
            bands.append((row, 1))
        elif bands:
            bands[-1] = (bands[-1][0], bands[-1][1] + piece.length // stride)
        else:
            return None
    below, a, b = _sums(pieces)
    if below[0] + pieces[0].length != size * stride:
        return None
    is_sound = chunk[-4:] == _SUMS.pack(b % _ADLER_MODULUS, a % _ADLER_MODULUS)
    return [(band,) for band in bands] if is_sound else None


# Without the cache this takes twenty times as long, since most strips occur again.
@lru_cache(maxsize=8_192)
def _unpack(compressed: bytes, stride: int, most: int) -> tuple[bytes, Piece] | None:
    """Return a row of pixels, or b"" for repetitions of the row above, with the unpacked piece.

    Args:
        compressed: Bytes up to a full flush.
        stride: The length of a row with its filter byte.
        most: The number of rows of the picture, and the most to unpack.

    Returns:
        None if the bytes hold neither of the two.
    """
    deflate = zlib.decompressobj(-zlib.MAX_WBITS)
    try:
        data = deflate.decompress(compressed, stride * most + 1)
    except zlib.error:
        return None
    row = data[1:] if data.startswith(_FILTER_NONE) and len(data) == stride else b""
    repeats = data == (_FILTER_UP + bytes(stride - 1)) * (len(data) // stride)
    if deflate.eof or not (row or repeats):
        return None
    return row, _piece(compressed, data)


def _file(header: bytes, chunk: bytes) -> bytes:
    """Return the PNG file of a header and one chunk, given as its name and data."""
    length, check = _NUMBER.pack(len(chunk) - 4), _NUMBER.pack(zlib.crc32(chunk))
    return b"".join((header, length, chunk, check, _END))


def _sums(pieces: Sequence[Piece]) -> tuple[list[int], int, int]:
    """Return the number of bytes after each piece, and the Adler-32 sums of all pieces joined.

    Each byte counts once in a, and in b as often as there are bytes from it to the end; a starts
    at 1 in each piece.
    """
    _, a, b, lengths = zip(*pieces, strict=True)
    length = sum(lengths)
    below = [length - end for end in accumulate(lengths)]
    return below, sum(a) - len(a) + 1, sum(b) + sum(map(mul, a, below)) - sum(below)


# How many rows per second the build writes without a cache: at 5x5 0.8 times as many without that
# of `_strip_piece`, 0.46 without `_repeat_piece`; at 25x25 0.88 without `_row_piece`.


@lru_cache(maxsize=8_192)
def _strip_piece(strip: Strip) -> Piece:
    pieces = []
    for row, count in strip:
        pieces.append(_row_piece(row))
        if count > 1:
            pieces.append(_repeat_piece(len(row), count - 1))
    _, a, b = _sums(pieces)
    compressed = b"".join([piece[0] for piece in pieces])
    length = sum([piece.length for piece in pieces])
    return Piece(compressed, a % _ADLER_MODULUS, b % _ADLER_MODULUS, length)


@lru_cache(maxsize=8_192)
def _row_piece(row: bytes) -> Piece:
    return _compress(_FILTER_NONE + row, LEVEL)


@lru_cache(maxsize=2_048)
def _repeat_piece(length: int, times: int) -> Piece:
    return _compress((_FILTER_UP + bytes(length)) * times, REPEAT_LEVEL)


def _compress(data: bytes, level: int) -> Piece:
    # Rows are short, so a small window and memory hold a whole row, and are faster to set up.
    deflate = zlib.compressobj(level, zlib.DEFLATED, _WINDOW_BITS, _MEMORY_LEVEL)
    return _piece(deflate.compress(data) + deflate.flush(zlib.Z_FULL_FLUSH), data)


def _piece(compressed: bytes, data: bytes) -> Piece:
    adler = zlib.adler32(data)
    return Piece(compressed, adler & 0xFFFF, adler >> 16, len(data))


def _chunk(kind: bytes, data: bytes) -> bytes:
    return _NUMBER.pack(len(data)) + kind + data + _NUMBER.pack(zlib.crc32(kind + data))


def _header(width: int, height: int) -> bytes:
    truecolour = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + _chunk(b"IHDR", truecolour)


_END = _chunk(b"IEND", b"")


class PictureDigest:
    """The sixteen-byte digest of a picture's pixels, also with some strips exchanged.

    The digest is the value of a polynomial at a fixed base, modulo 2**127 - 1. Its coefficients are
    the BLAKE2b hashes of the rows of pixels, sixteen bytes each; the constant term belongs to the
    lowest row (Karp and Rabin, 1987). Changing a row changes one term of the sum.
    """

    def __init__(self, strips: Sequence[Strip]) -> None:
        """Hash the picture as it is."""
        sums_and_heights = [_strip_sum(strip) for strip in strips]
        self._sums = [strip_sum for strip_sum, _ in sums_and_heights]
        self._powers = _powers(tuple(height for _, height in sums_and_heights))
        self._sum: int = sum(map(mul, self._sums, self._powers))

    @classmethod
    def of(cls, picture: NDArray[np.uint8]) -> bytes:
        """Return the digest of a picture, shape (rows, columns, 3)."""
        return cls(strips_in(picture)).digest({})

    def digest(self, changes: Mapping[int, Strip]) -> bytes:
        """Return the digest with strips exchanged: index from the top -> strip of that height."""
        total = self._sum
        for index, strip in changes.items():
            total += (_strip_sum(strip)[0] - self._sums[index]) * self._powers[index]
        return (total % _DIGEST_MODULUS).to_bytes(16, "little")


@lru_cache(maxsize=64)
def _powers(heights: tuple[int, ...]) -> list[int]:
    """Return the factor of each strip: the base raised to the number of rows below the strip."""
    powers = [1]
    for height in heights[:0:-1]:
        powers.append(powers[-1] * _repeated(height)[1] % _DIGEST_MODULUS)
    return powers[::-1]


# How many rows per second the build writes without a cache: at 5x5 0.7 times as many without that
# of `_strip_sum`, 0.6 without `_repeated`; at 25x25 0.96 without `_row_hash`.


@lru_cache(maxsize=8_192)
def _strip_sum(strip: Strip) -> tuple[int, int]:
    """Return the sum that a strip adds at the bottom of a picture, and the strip's height."""
    total = height = 0
    for row, count in strip:
        repeated, power = _repeated(count)
        total = (total * power + _row_hash(row) * repeated) % _DIGEST_MODULUS
        height += count
    return total, height


@lru_cache(maxsize=8_192)
def _row_hash(row: bytes) -> int:
    return int.from_bytes(hashlib.blake2b(row, digest_size=16).digest(), "little")


@lru_cache(maxsize=1_024)
def _repeated(count: int) -> tuple[int, int]:
    """Return the factors of a row that is repeated `count` times, and of everything above it.

    They are the sum of the powers of the base from 0 to `count` - 1, and the power `count`.
    """
    power = pow(_DIGEST_BASE, count, _DIGEST_MODULUS)
    return (power - 1) * pow(_DIGEST_BASE - 1, -1, _DIGEST_MODULUS) % _DIGEST_MODULUS, power

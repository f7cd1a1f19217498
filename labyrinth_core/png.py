"""A lossless PNG encoder for pictures that are made of few distinct rows of pixels.

General encoders compress every pixel of every picture, which costs milliseconds. Here a picture
is a sequence of strips, a strip a few rows of pixels with the number of times each is repeated.
Each strip is compressed once, ended with a full flush so that it stands alone, and remembered by
its content; a picture is the strips joined. The Adler-32 of the whole follows from those of the
strips. A repeated row is the filter "up" over nothing but zeros, whatever the row holds, so its
compressed form depends only on the length.

Pictures are truecolour, 8 bits a channel (colour type 2), so that every reader sees three
channels. Format: PNG, https://www.w3.org/TR/png-3/; deflate, RFC 1951; Adler-32, RFC 1950.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Sequence
from functools import lru_cache

Band = tuple[bytes, int]
"""A row of pixels, three bytes each, and how many times it is repeated."""

Strip = tuple[Band, ...]
"""Some bands, from top to bottom."""


class KeptStrip(Strip):
    """A strip that is drawn once and used in many pictures; caches know it by its identity.

    Hashing the content would cost more than the look-up it is for.
    """

    __slots__ = ()
    __hash__ = object.__hash__
    __eq__ = object.__eq__


LEVEL = 6
"""Of zlib. A changed level changes the bytes of every picture, though not its pixels."""

_WINDOW_BITS, _MEMORY_LEVEL = -12, 5
_ADLER_MODULUS = 65_521
_FILTER_NONE = b"\x00"
_FILTER_UP = b"\x02"
_ZLIB_HEADER = b"\x78\x01"
_LAST_BLOCK = b"\x03\x00"
"""An empty deflate block marked as the last."""

Piece = tuple[bytes, int, int, int]
"""Compressed bytes that stand alone; the two sums of Adler-32 and the length uncompressed."""


def encode(strips: Sequence[Strip], width: int) -> bytes:
    """Return the PNG file of a picture.

    Args:
        strips: The picture from top to bottom; every row has `3 * width` bytes.
        width: Pixels in a row.
    """
    pieces = [_strip_piece(strip) for strip in strips]
    compressed, a, b, length = _join(pieces)
    data = b"".join(
        (b"IDAT", _ZLIB_HEADER, compressed, _LAST_BLOCK, struct.pack(">I", b << 16 | a))
    )
    height = length // (3 * width + 1)
    return b"".join(
        (
            _header(width, height),
            struct.pack(">I", len(data) - 4),
            data,
            struct.pack(">I", zlib.crc32(data)),
            _END,
        )
    )


def _join(pieces: Sequence[Piece]) -> Piece:
    """Return the pieces one after the other as one."""
    a, b, length = 1, 0, 0
    for _, next_a, next_b, next_length in pieces:
        b += next_b + next_length * (a - 1)
        a += next_a - 1
        length += next_length
    joined = b"".join([piece[0] for piece in pieces])
    return joined, a % _ADLER_MODULUS, b % _ADLER_MODULUS, length


@lru_cache(maxsize=8_192)
def _strip_piece(strip: Strip) -> Piece:
    pieces = []
    for row, count in strip:
        pieces.append(_row_piece(row))
        if count > 1:
            pieces.append(_repeat_piece(len(row), count - 1))
    return _join(pieces)


@lru_cache(maxsize=8_192)
def _row_piece(row: bytes) -> Piece:
    return _compress(_FILTER_NONE + row)


@lru_cache(maxsize=2_048)
def _repeat_piece(length: int, times: int) -> Piece:
    return _compress((_FILTER_UP + bytes(length)) * times)


def _compress(data: bytes) -> Piece:
    # Rows are short: a small window and a small memory hold all of one, and are set up sooner.
    deflate = zlib.compressobj(LEVEL, zlib.DEFLATED, _WINDOW_BITS, _MEMORY_LEVEL)
    compressed = deflate.compress(data) + deflate.flush(zlib.Z_FULL_FLUSH)
    adler = zlib.adler32(data)
    return compressed, adler & 0xFFFF, adler >> 16, len(data)


def _chunk(kind: bytes, data: bytes) -> bytes:
    check = zlib.crc32(kind + data)
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", check)


@lru_cache(maxsize=64)
def _header(width: int, height: int) -> bytes:
    truecolour = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + _chunk(b"IHDR", truecolour)


_END = _chunk(b"IEND", b"")

"""The way back from `png.encode`: the strips of a picture, without unpacking what is known.

A general decoder unpacks every pixel of every picture, which costs milliseconds. The pictures of
this project are pieces of compressed data that stand alone, and few of them are new: each is
unpacked once and remembered by its bytes, and the checksum of a picture follows from those of its
pieces. Whatever is unlike `png.encode` in any way is left to a general decoder.

Format: PNG, https://www.w3.org/TR/png-3/; zlib and Adler-32, RFC 1950; deflate, RFC 1951.
"""

from __future__ import annotations

import struct
import zlib
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from labyrinth_core.pictures.png import Band, Strip

_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_FLUSH = b"\x00\x00\xff\xff"
"""What ends each piece: the length of an empty stored block (RFC 1951, section 3.2.4)."""
_DATA_AT = 41
"""Signature, header, and the length and name of the chunk with the data."""
_ADLER_MODULUS = 65_521
_MOST_ROWS = 16
"""Different rows in a piece that is remembered; a strip of ours has fewer."""


class _Piece(NamedTuple):
    """Some rows of pixels, unpacked."""

    bands: tuple[tuple[bytes | None, int], ...]
    """As in a strip; None repeats the row above, which may be in the piece before."""
    a: int
    b: int
    """The two sums of Adler-32."""
    length: int
    """Bytes unpacked."""


def strips_of(png: bytes, size: int) -> list[Strip] | None:
    """Return the strips of a PNG file made by `png.encode`, each a single band.

    Args:
        png: The file.
        size: Pixels that it has each way.

    Returns:
        None for every other file: of another size or kind, damaged, or no PNG at all.
    """
    data = _checked_data(png, size)
    if data is None:
        return None
    *whole, last = data[2:-4].split(_FLUSH)
    pieces = [_unpack(part + _FLUSH, size) for part in whole]
    pieces.append(_unpack(last, size))
    a, b, length = 1, 0, 0
    bands: list[Band] = []
    for piece in pieces:
        if piece is None:
            return None
        b += piece.b + piece.length * (a - 1)
        a += piece.a - 1
        length += piece.length
        for row, count in piece.bands:
            if row is not None:
                bands.append((row, count))
            elif bands:
                bands[-1] = (bands[-1][0], bands[-1][1] + count)
            else:
                return None
    adler = struct.pack(">HH", b % _ADLER_MODULUS, a % _ADLER_MODULUS)
    if length != size * (3 * size + 1) or adler != data[-4:]:
        return None
    return [(band,) for band in bands]


def _checked_data(png: bytes, size: int) -> bytes | None:
    """Return the zlib stream of a picture that is a header, one chunk of data and an end."""
    if not png.startswith(_head(size)) or not png.endswith(_END):
        return None
    end = len(png) - len(_END) - 4
    if png[_DATA_AT - 8 : _DATA_AT] != struct.pack(">I", max(0, end - _DATA_AT)) + b"IDAT":
        return None
    if zlib.crc32(png[_DATA_AT - 4 : end]) != int.from_bytes(png[end : end + 4], "big"):
        return None
    data = png[_DATA_AT:end]
    # Deflate with the usual window, no dictionary, and a header that says so.
    sound = len(data) > 6 and data[0] == 0x78 and not data[1] & 0x20
    return data if sound and not int.from_bytes(data[:2], "big") % 31 else None


@lru_cache(maxsize=8_192)
def _unpack(part: bytes, size: int) -> _Piece | None:
    """Return a piece, None for data that do not stand alone or hold other filters of rows."""
    stride = 3 * size + 1
    deflate = zlib.decompressobj(-zlib.MAX_WBITS)
    try:
        unpacked = deflate.decompress(part, stride * size + 1)
    except zlib.error:
        return None
    if len(unpacked) > stride * size or len(unpacked) % stride or deflate.unused_data:
        return None
    if part.endswith(_FLUSH) == deflate.eof:
        return None
    bands = _bands(unpacked, stride)
    if bands is None or len(bands) > _MOST_ROWS:
        return None
    adler = zlib.adler32(unpacked)
    return _Piece(bands, adler & 0xFFFF, adler >> 16, len(unpacked))


def _bands(unpacked: bytes, stride: int) -> tuple[tuple[bytes | None, int], ...] | None:
    """Return rows of pixels with the number of times they are repeated.

    Each begins with a byte for its filter: 0 for plain pixels, or 2 for differences from the row
    above, which have to be none.
    """
    rows = np.frombuffer(unpacked, np.uint8).reshape(-1, stride)
    same = rows[:, 0] == 2
    if rows[~same, 0].any() or rows[same, 1:].any():
        return None
    bands: list[tuple[bytes | None, int]] = []
    for row, is_same in zip(rows, same.tolist(), strict=True):
        if not is_same:
            bands.append((row[1:].tobytes(), 1))
        elif bands:
            bands[-1] = (bands[-1][0], bands[-1][1] + 1)
        else:
            bands.append((None, 1))
    return tuple(bands)


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


@lru_cache(maxsize=4)
def _head(size: int) -> bytes:
    # 8 bits a channel, truecolour, and the only kinds of compression, filter and no interlace.
    return _SIGNATURE + _chunk(b"IHDR", struct.pack(">IIBBBBB", size, size, 8, 2, 0, 0, 0))


_END = _chunk(b"IEND", b"")

"""The encoder's files read back piece by piece, and every other file left to other readers."""

import io
import struct
import zlib
from random import Random

import numpy as np
import pytest
from PIL import Image

from labyrinth_core.pictures.png import encode, strips_of

NOISE = Random(0).randbytes
STRIPS = [((NOISE(90), 1), (b"\xff" * 90, 20)), ((NOISE(90), 4),), ((NOISE(90), 5),)]


def pixels(strips):
    return b"".join(row * count for strip in strips for row, count in strip)


def pillow(png):
    """Return the pixels that Pillow finds in a file, None if it finds none."""
    try:
        with Image.open(io.BytesIO(png)) as image:
            return image.convert("RGB").tobytes()
    except (OSError, SyntaxError, ValueError):
        return None


HEADER = struct.pack(">IIBBBBB", 30, 30, 8, 2, 0, 0, 0)


def file_of(data, *, header=HEADER, more=()):
    """Return a PNG file with the given data, whatever they are, and checksums that agree."""

    def chunk(kind, content):
        check = zlib.crc32(kind + content)
        return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", check)

    chunks = [(b"IHDR", header), *more, (b"IDAT", data), (b"IEND", b"")]
    return b"\x89PNG\r\n\x1a\n" + b"".join(chunk(*each) for each in chunks)


def data_of(png):
    return png[41:-16]


def test_repeated_rows_are_counted_and_not_unpacked():
    assert strips_of(encode(STRIPS, 30), 30) == [(band,) for strip in STRIPS for band in strip]


def test_another_size_than_the_one_asked_for_is_left_to_others():
    png = encode(STRIPS, 30)
    assert strips_of(png, 31) is None
    assert strips_of(encode(STRIPS[1:], 30), 30) is None


@pytest.mark.parametrize("mode", ["RGB", "RGBA", "L", "P", "1"])
def test_files_of_other_encoders_are_left_to_others_unless_the_pixels_are_the_same(mode):
    picture = Image.frombytes("RGB", (30, 30), pixels(STRIPS)).convert(mode)
    for level in (0, 1, 9):
        file = io.BytesIO()
        picture.save(file, "PNG", compress_level=level)
        strips = strips_of(file.getvalue(), 30)
        assert strips is None or pixels(strips) == pillow(file.getvalue())


def test_every_flipped_bit_and_every_cut_is_noticed():
    png = encode(STRIPS, 30)
    for place in range(len(png)):
        for bit in range(8):
            damaged = bytearray(png)
            damaged[place] ^= 1 << bit
            assert strips_of(bytes(damaged), 30) is None
        assert strips_of(png[:place], 30) is None
    assert strips_of(png + b"\0", 30) is None


def test_damage_under_a_checksum_that_agrees_is_noticed_or_read_as_others_read_it():
    data = data_of(encode(STRIPS, 30))
    random = np.random.default_rng(0)
    for place in random.integers(len(data), size=400).tolist():
        damaged = bytearray(data)
        damaged[place] = int(random.integers(256))
        png = file_of(bytes(damaged))
        strips = strips_of(png, 30)
        assert strips is None or pixels(strips) == pillow(png)


def rows(*filtered):
    return zlib.compress(b"".join(filtered))


PLAIN = [b"\0" + bytes(90)] * 30


NOT_OURS = {
    "no file": b"",
    "no data": file_of(b""),
    "cut short": file_of(rows(*PLAIN)[:-1]),
    "more after the end": file_of(rows(*PLAIN) + b"more"),
    "a row missing": file_of(rows(*PLAIN[1:])),
    "rows too many": file_of(rows(*PLAIN, *PLAIN)),
    "another filter": file_of(rows(b"\1" + NOISE(90), *PLAIN[1:])),
    "differences from above": file_of(rows(*PLAIN[1:], b"\2" + NOISE(90))),
    "above the first row": file_of(rows(b"\2" + bytes(90), *PLAIN[1:])),
    "far too much": file_of(zlib.compress(bytes(10**6))),
    "a chunk more": file_of(rows(*PLAIN), more=[(b"tRNS", bytes(6))]),
    "interlaced": file_of(rows(*PLAIN), header=struct.pack(">IIBBBBB", 30, 30, 8, 2, 0, 0, 1)),
    "too many different rows to remember": file_of(rows(*(b"\0" + NOISE(90) for _ in PLAIN))),
}


@pytest.mark.parametrize("png", NOT_OURS.values(), ids=NOT_OURS)
def test_what_the_encoder_does_not_write_is_left_to_others(png):
    assert strips_of(png, 30) is None

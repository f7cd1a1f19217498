"""The encoder's files: strict PNG, and the pixels that were given; and the digest of pixels."""

import hashlib
import io
import random
import subprocess

import numpy as np
import pygame
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from PIL import Image

from labyrinth_core.pictures import PictureDigest
from labyrinth_core.pictures.png import Mosaic, encode

WHITE, BLACK = b"\xff\xff\xff", b"\0\0\0"


@st.composite
def pictures(draw):
    """Some strips, few of them distinct, and their width."""
    width = draw(st.integers(1, 40))
    colours = draw(st.lists(st.binary(min_size=3, max_size=3), min_size=1, max_size=4))
    noise = st.binary(min_size=3 * width, max_size=3 * width)
    runs = st.lists(st.sampled_from(colours), min_size=width, max_size=width).map(b"".join)
    bands = st.tuples(noise | runs, st.integers(1, 30))
    strips = draw(st.lists(st.lists(bands, min_size=1, max_size=3).map(tuple), min_size=1))
    order = st.lists(st.sampled_from(strips), min_size=1, max_size=12)
    return draw(order), width


def large_picture():
    """Return noise and white, 600 pixels wide, with sums far beyond the modulus of Adler-32."""
    noise = random.Random(0).randbytes
    strips = [((noise(1800), 1), (WHITE * 600, 400)), ((noise(1800), 70),), ((WHITE * 600, 1),)]
    return strips * 3, 600


def pixels(strips, width):
    """Return the picture that strips describe, shape (height, width, 3)."""
    data = b"".join(row * count for strip in strips for row, count in strip)
    return np.frombuffer(data, np.uint8).reshape(-1, width, 3)


@pytest.mark.slow
@given(pictures())
@example(large_picture())
@example(([((BLACK, 1),)], 1))
def test_pillow_and_pygame_decode_the_pixels_that_were_given(picture):
    strips, width = picture
    file = encode(strips, width)
    with Image.open(io.BytesIO(file)) as image:
        assert image.format == "PNG"
        assert image.mode == "RGB"
        by_pillow = np.asarray(image)
    surface = pygame.image.load(io.BytesIO(file), "picture.png")
    by_pygame = pygame.surfarray.array3d(surface).swapaxes(0, 1)
    np.testing.assert_array_equal(by_pillow, pixels(strips, width))
    np.testing.assert_array_equal(by_pygame, pixels(strips, width))


@given(pictures(), st.data())
@example(large_picture(), None)
def test_a_mosaic_with_strips_exchanged_is_the_picture_of_those_strips(picture, data):
    strips, width = picture
    colour = st.binary(min_size=3, max_size=3)
    changes = {
        place: tuple(((data.draw(colour) if data else BLACK) * width, n) for _, n in strips[place])
        for place in (data.draw(st.sets(st.integers(0, len(strips) - 1))) if data else [0, 3])
    }
    mosaic = Mosaic(strips, width)
    changed = [changes.get(place, strip) for place, strip in enumerate(strips)]
    assert mosaic.encode(changes) == encode(changed, width)
    assert mosaic.encode({}) == encode(strips, width)


def test_a_strip_of_another_height_is_refused():
    mosaic = Mosaic([((BLACK, 2),), ((WHITE, 3),)], 1)
    with pytest.raises(ValueError, match="strip 1: 8 bytes of rows, not 12"):
        mosaic.encode({1: ((WHITE, 2),)})


@pytest.mark.programs("pngcheck")
def test_pngcheck_finds_nothing_wrong(tmp_path):
    rows = [random.Random(width).randbytes(3 * width) for width in (1, 7, 64, 600)]
    files = [
        encode([((row, 5), (WHITE * (len(row) // 3), 2)), ((row, 1),)], len(row) // 3)
        for row in rows
    ]
    for number, file in enumerate([*files, encode(*large_picture())]):
        path = tmp_path / f"{number}.png"
        path.write_bytes(file)
        checked = subprocess.run(["pngcheck", "-v", path], capture_output=True, text=True)
        assert checked.returncode == 0, checked.stdout
        assert "No errors detected" in checked.stdout


# The digest.


def digest(*strips):
    return PictureDigest(strips).digest({})


@given(pictures())
def test_a_picture_has_the_same_digest_in_bands_and_decoded(picture):
    strips, width = picture
    assert digest(*strips) == PictureDigest.of(pixels(strips, width))


@given(pictures(), st.data())
def test_a_picture_with_strips_exchanged_has_the_digest_it_has_anew(picture, data):
    strips, width = picture
    rows = st.binary(min_size=3 * width, max_size=3 * width)
    places = data.draw(st.sets(st.integers(0, len(strips) - 1)))
    changes = {
        place: tuple((data.draw(rows), count) for _, count in strips[place])
        for place in sorted(places)
    }
    changed = [changes.get(place, strip) for place, strip in enumerate(strips)]
    assert PictureDigest(strips).digest(changes) == digest(*changed)


def test_the_digest_is_the_polynomial_that_is_written_down():
    rows = [b"abcdef", b"ghijkl", b"ghijkl", b"abcdef"]
    base, modulus = 0x4F1BBCDCBFA53E0AF9CE60302E76E41A, 2**127 - 1
    value = 0
    for row in rows:
        hashed = hashlib.blake2b(row, digest_size=16).digest()
        value = (value * base + int.from_bytes(hashed, "little")) % modulus
    assert digest(*(((row, 1),) for row in rows)) == value.to_bytes(16, "little")

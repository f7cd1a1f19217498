"""The encoder's files: strict PNG, the pixels that were given, the same bytes everywhere."""

import base64
import hashlib
import io
import os
import random
import shutil
import struct
import subprocess
import sys
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from known_labyrinths import KEY_AND_DOOR
from PIL import Image

from labyrinth_core.language.text import parse
from labyrinth_core.pictures.png import PICTURE_SIZE, Mosaic, encode
from labyrinth_core.pictures.renderer import Painter
from labyrinth_core.world.dynamics import State

LABYRINTH = parse(KEY_AND_DOOR)
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


def chunks(file):
    """Return the chunks of a PNG file as (kind, data), having checked all that surrounds them."""
    assert file[:8] == b"\x89PNG\r\n\x1a\n"
    found, at = [], 8
    while at < len(file):
        (length,) = struct.unpack_from(">I", file, at)
        kind, data = file[at + 4 : at + 8], file[at + 8 : at + 8 + length]
        (check,) = struct.unpack_from(">I", file, at + 8 + length)
        assert len(data) == length
        assert check == zlib.crc32(kind + data)
        found.append((kind, data))
        at += 12 + length
    assert at == len(file)
    return found


def inflate(data):
    """Return what a zlib stream holds; it has to be complete, with nothing behind it."""
    stream = zlib.decompressobj()
    inflated = stream.decompress(data)
    assert stream.eof
    assert stream.unused_data == b""
    return inflated


@pytest.mark.slow
@given(pictures())
@example(large_picture())
@example(([((BLACK, 1),)], 1))
def test_pillow_and_opencv_decode_the_pixels_that_were_given(picture):
    strips, width = picture
    file = encode(strips, width)
    with Image.open(io.BytesIO(file)) as image:
        assert image.format == "PNG"
        assert image.mode == "RGB"
        by_pillow = np.asarray(image)
    by_opencv = cv2.imdecode(np.frombuffer(file, np.uint8), cv2.IMREAD_UNCHANGED)[..., ::-1]
    np.testing.assert_array_equal(by_pillow, pixels(strips, width))
    np.testing.assert_array_equal(by_opencv, pixels(strips, width))


PAGE = """<!doctype html><script>
onload = () => {
  document.body.dataset.sums = [...document.images].map(image => {
    const canvas = new OffscreenCanvas(image.naturalWidth, image.naturalHeight);
    const context = canvas.getContext("2d");
    context.drawImage(image, 0, 0);
    const pixels = context.getImageData(0, 0, canvas.width, canvas.height).data;
    let a = 1, b = 0;
    for (let place = 0; place < pixels.length; place += 1) {
      a = (a + pixels[place]) % 65521;
      b = (b + a) % 65521;
    }
    return b * 65536 + a;
  }).join(" ");
};
</script>"""


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("chromium") is None, reason="Chromium is not installed")
def test_chromium_decodes_the_pixels_that_were_given(tmp_path):
    some = [large_picture(), ([((BLACK + WHITE, 1), (WHITE + BLACK, 7))], 2)]
    states = State(0), State(7, has_key=True)
    some += [(Painter(LABYRINTH).strips(state), PICTURE_SIZE) for state in states]
    images = [base64.b64encode(encode(*picture)).decode() for picture in some]
    page = tmp_path / "page.html"
    page.write_text(PAGE + "".join(f'<img src="data:image/png;base64,{i}">' for i in images))
    options = ["--headless", "--no-sandbox", "--disable-gpu", f"--user-data-dir={tmp_path}/profile"]
    browser = subprocess.run(
        ["chromium", *options, "--dump-dom", page], capture_output=True, text=True, timeout=120
    )
    opaque = [np.insert(pixels(*picture), 3, 255, axis=2) for picture in some]
    sums = " ".join(str(zlib.adler32(picture.tobytes())) for picture in opaque)
    assert f'data-sums="{sums}"' in browser.stdout, browser.stderr


@pytest.mark.slow
@given(pictures())
@example(large_picture())
def test_a_file_is_a_truecolour_header_one_data_chunk_and_an_end(picture):
    strips, width = picture
    (header, ihdr), (data, _), (end, nothing) = chunks(encode(strips, width))
    height = sum(count for strip in strips for _, count in strip)
    assert (header, data, end, nothing) == (b"IHDR", b"IDAT", b"IEND", b"")
    depth, colour_type, deflate, adaptive, not_interlaced = 8, 2, 0, 0, 0
    assert struct.unpack(">IIBBBBB", ihdr) == (
        *(width, height),
        *(depth, colour_type, deflate, adaptive, not_interlaced),
    )


@pytest.mark.slow
@given(pictures())
@example(large_picture())
def test_each_line_is_a_row_as_it_is_or_the_difference_to_the_row_above(picture):
    strips, width = picture
    lines = np.frombuffer(inflate(chunks(encode(strips, width))[1][1]), np.uint8)
    filters, differences = np.hsplit(lines.reshape(-1, 3 * width + 1), [1])
    assert set(filters.ravel().tolist()) <= {0, 2}
    rows = [np.zeros(3 * width, np.uint8)]
    for kind, difference in zip(filters.ravel().tolist(), differences, strict=True):
        rows.append(difference + rows[-1] if kind == 2 else difference)
    np.testing.assert_array_equal(np.stack(rows[1:]).ravel(), pixels(strips, width).ravel())


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


def some_pictures():
    """Return pictures that share rows and strips, whatever process asks."""
    noise = random.Random(1).randbytes
    rows = [noise(90), BLACK * 30, WHITE * 30]
    strips = [((row, count),) for row in rows for count in (1, 2, 40)]
    strips += [((one, 3), (other, 5)) for one in rows for other in rows]
    return [(random.Random(number).choices(strips, k=9), 30) for number in range(60)]


@pytest.mark.slow
def test_another_process_that_encoded_other_pictures_before_makes_the_same_bytes():
    """What the encoder remembers, and the hashes of a process, change no byte."""
    program = (
        "import hashlib, sys\n"
        "from test_png import encode, large_picture, some_pictures\n"
        "files = [encode(*each) for each in [*some_pictures(), large_picture()][::-1]][::-1]\n"
        "print(hashlib.sha256(b''.join(files)).hexdigest())\n"
    )
    path = os.pathsep.join([str(Path(__file__).parent), *sys.path])
    other = subprocess.run(
        [sys.executable, "-c", program],
        env=os.environ | {"PYTHONHASHSEED": "7", "PYTHONPATH": path},
        capture_output=True,
        text=True,
        check=True,
    )
    files = [encode(*each) for each in [*some_pictures(), large_picture()]]
    assert other.stdout.strip() == hashlib.sha256(b"".join(files)).hexdigest()


@pytest.mark.skipif(shutil.which("pngcheck") is None, reason="pngcheck is not installed")
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

"""Pictures at another size straight from their strips, the exact mean of what each pixel covers.

A strip comes back at the same height in many pictures, so what it adds to the pixels of the small
picture is worked out once. All sums are in whole numbers: the result is that of
`renderer.area_average` on the large picture, to the last bit.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache, partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.png import Strip
from labyrinth_core.renderer import PICTURE_SIZE

REMEMBERED_BYTES = 32 * 2**20
"""About what the shares of strips that are remembered may take, for each size of picture.

The narrowed rows they are made of may take as much again.
"""

_AREA = PICTURE_SIZE**2


class _Share(NamedTuple):
    """What a strip adds to a small picture, before the division by the area."""

    first: int
    """The first row of pixels that it touches."""
    end: int
    sums: NDArray[np.int32]
    """Shape (end - first, image_size * 3); at most 255 * 600 * 600 in all, which fits."""
    height: int
    """Rows of the strip in the large picture."""


def shrink(strips: Sequence[Strip], image_size: int) -> NDArray[np.uint8]:
    """Return a picture at another size, each pixel the rounded mean of what it covers.

    Args:
        strips: The picture of `PICTURE_SIZE` each way, from top to bottom.
        image_size: Side of the result, shape (image_size, image_size, 3).
    """
    if image_size == PICTURE_SIZE:
        return _unshrunk(strips)
    share_of = _remembering_shares(image_size)
    # Half the area first, so that the division rounds.
    sums = np.full((image_size, 3 * image_size), _AREA // 2, np.int32)
    top = 0
    for strip in strips:
        first, end, share, height = share_of(strip, top)
        sums[first:end] += share
        top += height
    sums //= _AREA
    return sums.astype(np.uint8).reshape(image_size, image_size, 3)


def _unshrunk(strips: Sequence[Strip]) -> NDArray[np.uint8]:
    bands = [band for strip in strips for band in strip]
    rows = np.frombuffer(b"".join([row for row, _ in bands]), np.uint8)
    counts = [count for _, count in bands]
    return rows.reshape(len(bands), PICTURE_SIZE, 3).repeat(counts, axis=0)


@lru_cache(maxsize=4)
def _remembering_shares(image_size: int) -> Callable[[Strip, int], _Share]:
    # A tenth of a picture is about what a strip is of, with the rows it shares with the next.
    share_bytes = 4 * 3 * image_size * (image_size // 10 + 2)
    shares = max(32, REMEMBERED_BYTES // share_bytes)
    return lru_cache(maxsize=shares)(partial(_share, image_size=image_size))


def _share(strip: Strip, top: int, *, image_size: int) -> _Share:
    height = sum(count for _, count in strip)
    first = top * image_size // PICTURE_SIZE
    end = -(-(top + height) * image_size // PICTURE_SIZE)
    sums = np.zeros((end - first, 3 * image_size), np.int32)
    narrow = _remembering_narrow(image_size)
    for row, count in strip:
        covered = _overlap(np.array([top]), count, np.arange(first, end), image_size)
        sums += covered * narrow(row)
        top += count
    return _Share(first, end, sums, height)


@lru_cache(maxsize=4)
def _remembering_narrow(image_size: int) -> Callable[[bytes], NDArray[np.int32]]:
    rows = max(32, REMEMBERED_BYTES // (4 * 3 * image_size))
    return lru_cache(maxsize=rows)(partial(_narrow, image_size=image_size))


def _narrow(row: bytes, image_size: int) -> NDArray[np.int32]:
    """Return a row of pixels at another width, times its old width, shape (image_size * 3,)."""
    pixels = np.frombuffer(row, np.uint8).reshape(PICTURE_SIZE, 3)
    # In floats, which hold these whole numbers exactly and are multiplied much faster.
    sums = _coverage(image_size) @ pixels.astype(np.float64)
    return sums.astype(np.int32).reshape(-1)


@lru_cache(maxsize=4)
def _coverage(image_size: int) -> NDArray[np.float64]:
    """Return how much of each pixel a small one covers, shape (image_size, PICTURE_SIZE)."""
    covered = _overlap(np.arange(PICTURE_SIZE), 1, np.arange(image_size), image_size)
    return covered.astype(np.float64)


def _overlap(
    starts: NDArray[np.int64], length: int, targets: NDArray[np.int64], image_size: int
) -> NDArray[np.int32]:
    """Return how much of each run of pixels lies under each pixel of the small picture.

    Args:
        starts: First pixel of each run, shape (S,).
        length: Pixels in each run.
        targets: Pixels of the small picture, shape (T,).
        image_size: Side of the small picture.

    Returns:
        Shape (T, S), in a unit of which a pixel is `image_size` and a small one `PICTURE_SIZE`.
    """
    begins, ends = starts * image_size, (starts + length) * image_size
    lows = targets[:, None] * PICTURE_SIZE
    overlap: NDArray[np.int64] = np.minimum(ends, lows + PICTURE_SIZE) - np.maximum(begins, lows)
    return overlap.clip(0).astype(np.int32)

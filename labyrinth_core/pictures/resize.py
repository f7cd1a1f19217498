"""Resize pictures, from their pixels or directly from their strips.

By `area`, the default, each pixel is the exact mean of what it covers; resizing strips gives the
result of `area_average` to the last bit. By `bilinear`, each pixel is interpolated between the four
pixels nearest to its centre without antialiasing, as PyTorch resizes tensors by default
(`torch.nn.functional.interpolate`, `align_corners=False`): thin lines between two centres vanish.
Use it to compare with results that were obtained that way.

A strip occurs at the same height in many pictures, so its share of the small picture is computed
once. All sums are integers.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import lru_cache, partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.pictures.png import PICTURE_SIZE, Strip

REMEMBERED_BYTES = 32 * 2**20
"""The size of the cache of shares of strips, for each picture size.

The cache of narrowed rows, from which shares are made, can be as large.
"""

RESIZES = ("area", "bilinear")
"""The ways to resize a picture; `bilinear` can only shrink it."""


class _Share(NamedTuple):
    """The sums that a strip adds to a small picture, before the division."""

    first: int
    """The first row of pixels that it touches."""
    end: int
    sums: NDArray[np.int32]
    """Shape (end - first, image_size * 3); values up to 255 * 600 * 600, which fit an int32."""
    height: int
    """The number of rows of the strip in the large picture."""


def shrink(strips: Sequence[Strip], image_size: int) -> NDArray[np.uint8]:
    """Return a picture at another size, area-averaged.

    Args:
        strips: The picture at `PICTURE_SIZE`, from top to bottom.
        image_size: The side of the result, shape (image_size, image_size, 3).
    """
    if image_size == PICTURE_SIZE:
        bands = [band for strip in strips for band in strip]
        rows = np.frombuffer(b"".join([row for row, _ in bands]), np.uint8)
        counts = [count for _, count in bands]
        return rows.reshape(len(bands), PICTURE_SIZE, 3).repeat(counts, axis=0)
    share_of = _remembering_shares(image_size)
    unit = int(weights(image_size)[0].sum()) ** 2
    # Start with half a unit, so that the division rounds.
    sums = np.full((image_size, 3 * image_size), unit // 2, np.int32)
    top = 0
    for strip in strips:
        first, end, share, height = share_of(strip, top)
        sums[first:end] += share
        top += height
    sums //= unit
    return sums.astype(np.uint8).reshape(image_size, image_size, 3)


def area_average(picture: NDArray[np.uint8], image_size: int) -> NDArray[np.uint8]:
    """Return a square picture at another size, each pixel the rounded mean of what it covers.

    Args:
        picture: Shape (side, side, 3).
        image_size: The side of the result, shape (image_size, image_size, 3).
    """
    side = len(picture)
    if side == image_size:
        return picture
    weight_of = weights(image_size, side=side)
    # The sums are integers below 2 ** 53, which floats hold exactly.
    rows = weight_of @ picture.reshape(side, -1).astype(np.float64)
    sums = weight_of @ rows.reshape(image_size, side, 3)
    unit = int(weight_of[0].sum()) ** 2
    return ((2 * sums + unit) // (2 * unit)).astype(np.uint8)


# The speed without the caches of shares: 0.25 times for new pictures of 5x5, 0.7 times for new ones
# of 15x15, and 0.15 times for pictures whose strips have occurred before.


@lru_cache(maxsize=4)
def _remembering_shares(image_size: int) -> Callable[[Strip, int], _Share]:
    # A strip covers about a tenth of a picture, and two rows that it shares with other strips.
    share_bytes = 4 * 3 * image_size * (image_size // 10 + 2)
    shares = max(32, REMEMBERED_BYTES // share_bytes)
    return lru_cache(maxsize=shares)(partial(_share, image_size=image_size))


def _share(strip: Strip, top: int, *, image_size: int) -> _Share:
    height = sum(count for _, count in strip)
    weight_of = weights(image_size)
    touched = np.flatnonzero(weight_of[:, top : top + height].any(axis=1))
    first, end = (int(touched[0]), int(touched[-1]) + 1) if touched.size else (0, 0)
    sums = np.zeros((end - first, 3 * image_size), np.int32)
    narrow = _remembering_narrow(image_size)
    for row, count in strip:
        weight = weight_of[first:end, top : top + count].sum(axis=1, keepdims=True)
        sums += weight.astype(np.int32) * narrow(row)
        top += count
    return _Share(first, end, sums, height)


@lru_cache(maxsize=4)
def _remembering_narrow(image_size: int) -> Callable[[bytes], NDArray[np.int32]]:
    rows = max(32, REMEMBERED_BYTES // (4 * 3 * image_size))
    return lru_cache(maxsize=rows)(partial(_narrow, image_size=image_size))


def _narrow(row: bytes, image_size: int) -> NDArray[np.int32]:
    """Return a row of pixels at another width, as weighted sums, shape (image_size * 3,)."""
    pixels = np.frombuffer(row, np.uint8).reshape(PICTURE_SIZE, 3)
    # Floats hold these integers exactly, and multiply much faster.
    sums = weights(image_size) @ pixels.astype(np.float64)
    return sums.astype(np.int32).reshape(-1)


# Without the cache, shrinking a picture takes eight times as long.
@lru_cache(maxsize=4)
def weights(image_size: int, resize: str = "area", side: int = PICTURE_SIZE) -> NDArray[np.float64]:
    """Return the weight of each large pixel in each small one, shape (image_size, side).

    Weights are integers with the same sum for every small pixel.

    Args:
        image_size: The side of the small picture.
        resize: One of `RESIZES`.
        side: The side of the large picture.
    """
    small, large = np.arange(image_size)[:, None], np.arange(side)
    if resize == "area":
        starts, lows = large * image_size, small * side
        shares = np.minimum(starts + image_size, lows + side) - np.maximum(starts, lows)
    else:
        # From the centre of the first large pixel to the centre of the small one.
        centres = side * (2 * small + 1) - image_size
        shares = 2 * image_size - abs(2 * image_size * large - centres)
    return (shares.clip(0) // math.gcd(image_size, side)).astype(np.float64)

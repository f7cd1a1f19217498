"""Keys that all rotations and reflections of a structure share."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

Planes = tuple[NDArray[np.bool_], NDArray[np.bool_], NDArray[np.bool_]]
"""Passages up (n, height - 1, width) and right (n, height, width - 1), marks (n, m, height, width).

Axes of the grid: row 0 at the bottom, column 0 at the left.
"""


def canonical_keys(
    height: int, width: int, passages: NDArray[np.bool_], cells: NDArray[np.int64] | None = None
) -> list[tuple[int, int, bytes]]:
    """Return a key for each structure, the same for all its rotations and reflections.

    Args:
        height: Rows of all structures.
        width: Columns.
        passages: As `near_twins.passage_table` gives them, shape (n, passages).
        cells: Marked cells, shape (n, m); if they are given, those whose key is the same are
            made the same together with them.
    """
    count, vertical = len(passages), (height - 1) * width
    marks = np.zeros((count, 0 if cells is None else cells.shape[1], height * width), np.bool_)
    if cells is not None:
        np.put_along_axis(marks, cells[:, :, None], True, axis=2)
    planes = (
        passages[:, :vertical].reshape(count, height - 1, width),
        passages[:, vertical:].reshape(count, height, width - 1),
        marks.reshape(count, -1, height, width),
    )
    least: NDArray[Any] | None = None
    for image in _images(planes):
        if (image[2].shape[2] <= image[2].shape[3]) or height == width:
            flat = np.concatenate([plane.reshape(count, -1) for plane in image], axis=1)
            packed = np.packbits(flat, axis=1)
            key = packed.view(f"S{packed.shape[1]}")[:, 0]
            least = key if least is None else np.where(key < least, key, least)
    assert least is not None
    return [(min(height, width), max(height, width), key) for key in least.tolist()]


def _images(planes: Planes) -> Iterator[Planes]:
    """Yield the eight images, the given one first; see `Structure.symmetries`."""
    up, right, marks = planes
    for turn in range(8):
        yield up, right, marks
        if turn % 2:  # Left and right exchanged.
            up, right, marks = up[..., ::-1], right[..., ::-1], marks[..., ::-1]
        else:  # Rows and columns exchanged.
            up, right = right.swapaxes(1, 2), up.swapaxes(1, 2)
            marks = marks.swapaxes(2, 3)

"""Square windows of many pictures, copied together.

A row of a window is one item of a view, so that numpy copies it at once.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Pictures = NDArray[np.uint8]
"""Shape (N, image_size, image_size, 3)."""
Numbers = NDArray[np.intp]
Corners = tuple[Numbers, Numbers]
"""The first row and the first column of each window."""


def paste(pictures: Pictures, places: Numbers, corners: Corners, patches: Pictures) -> None:
    """Put a patch into each of some pictures.

    Args:
        pictures: Shape (N, image_size, image_size, 3), C-contiguous.
        places: The number of the picture of each patch, shape (M,).
        corners: The first row and the first column of each patch, shape (M,) each.
        patches: Shape (M, reach, reach, 3).
    """
    reach = patches.shape[1]
    rows, where = runs(pictures, reach), _where(places, corners, reach)
    rows[where] = patches.reshape(*patches.shape[:2], -1).view(rows.dtype)[..., 0]


def cut(pictures: Pictures, places: Numbers, corners: Corners, reach: int) -> Pictures:
    """Return the patches, `reach` pixels high and wide, that pictures have; see `paste`."""
    rows = runs(pictures, reach)[_where(places, corners, reach)]
    return rows.view(np.uint8).reshape(len(places), reach, reach, 3)


def _where(places: Numbers, corners: Corners, reach: int) -> tuple[Numbers, Numbers, Numbers]:
    """Return the indices of the runs of patches, see `runs`."""
    tops, lefts = corners
    return places[:, None], tops[:, None] + np.arange(reach), lefts[:, None]


def runs(pixels: NDArray[Any], length: int) -> NDArray[np.void]:
    """Return a view of the runs of pixels along rows, each as one item, from each pixel on.

    Args:
        pixels: Shape (N, rows, columns, 3), C-contiguous.
        length: The length of a run; the view has the shape (N, rows, columns - length + 1).
    """
    count, rows, columns, _ = pixels.shape
    item = np.dtype((np.void, length * pixels.strides[2]))
    shape = (count, rows, columns - length + 1)
    view: NDArray[np.void] = np.ndarray(shape, item, pixels.data, strides=pixels.strides[:3])
    return view

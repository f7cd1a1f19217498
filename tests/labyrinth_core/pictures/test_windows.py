"""Windows of pictures: what is cut out of them, and pasted into them."""

import numpy as np

from labyrinth_core.pictures.windows import cut, paste


def test_what_is_cut_out_of_pictures_can_be_pasted_back():
    pictures = np.random.default_rng(0).integers(256, size=(5, 9, 9, 3), dtype=np.uint8)
    before, places = pictures.copy(), np.array([3, 0])
    corners = np.array([2, 6]), np.array([0, 5])
    patches = cut(pictures, places, corners, 3)
    np.testing.assert_array_equal(patches[1], before[0, 6:9, 5:8])
    paste(pictures, places, corners, 255 - patches)
    np.testing.assert_array_equal(pictures[3, 2:5, 0:3], 255 - before[3, 2:5, 0:3])
    assert (pictures != before).any(axis=-1).sum() == 18
    paste(pictures, places, corners, patches)
    np.testing.assert_array_equal(pictures, before)

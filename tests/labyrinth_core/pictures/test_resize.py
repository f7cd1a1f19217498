"""Small pictures from strips: those that averaging the large ones gives, to the last bit."""

import tracemalloc
from random import Random

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.strategies import labyrinths

from labyrinth_core.pictures import ObservationSpec, Painter
from labyrinth_core.pictures.resize import area_average, shrink


@pytest.mark.slow
@settings(max_examples=40)
@given(labyrinths(), st.integers(1, 130) | st.sampled_from([224, 299, 401, 600]), st.data())
def test_a_drawn_picture_is_the_averaged_large_one(labyrinth, image_size, data):
    state = labyrinth.state_at(data.draw(st.integers(0, labyrinth.state_count - 1)))
    painter = Painter(labyrinth)
    small = painter.array(state, image_size)
    assert small.flags.writeable
    np.testing.assert_array_equal(small, area_average(painter.array(state), image_size))
    (decoded,) = ObservationSpec("image", image_size).decoded([painter.png(state)])
    np.testing.assert_array_equal(small, decoded)


@pytest.mark.slow
def test_what_is_remembered_takes_no_more_than_a_fixed_space():
    random = Random(0)
    tracemalloc.start()
    try:
        for _ in range(100):  # A thousand strips, of which no two are equal: 110 MB of shares.
            shrink([((random.randbytes(1800), 60),) for _ in range(10)], 299)
        remembered, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert remembered < 2.2 * 32 * 2**20

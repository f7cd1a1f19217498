"""Cells, actions, neighbours and sizes."""

import re

import numpy as np
import pytest
from brute_force import WAYS, grid_passages
from hypothesis import given
from hypothesis import strategies as st

from labyrinth_core.world.grid import (
    MAX_SIDE,
    MIN_SIDE,
    Action,
    horizontal_edges,
    neighbours,
    parse_size,
    vertical_edges,
    whole,
)

sides = st.integers(2, 12)
valid_sides = st.integers(MIN_SIDE, MAX_SIDE)


@given(sides, sides, st.data())
def test_an_action_leads_to_the_neighbour_in_its_direction(height, width, data):
    cell = data.draw(st.integers(0, height * width - 1))
    row, column = divmod(cell, width)
    expected = {
        action: (row + rows) * width + column + columns
        for action, (rows, columns) in WAYS.items()
        if 0 <= row + rows < height and 0 <= column + columns < width
    }
    assert neighbours(cell, height, width) == expected


@given(sides, sides)
def test_the_edge_sets_hold_every_pair_of_neighbours_once(height, width):
    up, right = vertical_edges(height, width), horizontal_edges(height, width)
    pairs = [
        frozenset({divmod(cell, width), divmod(cell + step, width)})
        for bits, step in ((up, width), (right, 1))
        for cell in range(bits.bit_length())
        if bits >> cell & 1
    ]
    assert sorted(map(sorted, pairs)) == sorted(map(sorted, grid_passages(height, width)))


@given(valid_sides, valid_sides)
def test_a_size_is_height_by_width_and_one_number_a_square(height, width):
    assert parse_size(f"{height}x{width}") == (height, width)
    assert parse_size(str(height)) == (height, height)


@pytest.mark.parametrize("text", [" 4x6 ", "4X6", "4 x 6", "04x6"])
def test_a_size_may_be_written_loosely(text):
    assert parse_size(text) == (4, 6)


@pytest.mark.parametrize(
    "text",
    (
        "|x|1|0|-3|1001|3x|x3|3x1|1x3|3x1001|3x3x3|3,4|3.0|3 4|three|1e1|0x10|"
        "\N{ARABIC-INDIC DIGIT THREE}|3x\N{ARABIC-INDIC DIGIT THREE}|" + "9" * 5000
    ).split("|"),
)
def test_a_size_that_is_none_is_refused_with_what_is_allowed(text):
    with pytest.raises(ValueError, match=r"^size=.*: give a whole number from 2 to 1,000 such as"):
        parse_size(text)


KINDS = [int, np.int8, np.uint8, np.int16, np.uint16, np.int32, np.uint32, np.int64, np.uint64]


@pytest.mark.parametrize("kind", KINDS)
def test_a_whole_number_of_any_kind_becomes_one_of_pythons(kind):
    number = whole("size", kind(5), 5, 5)
    assert (number, type(number)) == (5, int)
    assert whole("seed", 2**70, 0) == 2**70
    assert type(whole("action", Action.LEFT)) is int


@pytest.mark.parametrize(
    "value",
    [True, np.True_, 5.0, np.float64(5), np.timedelta64(5), "5", b"5", None, [5], np.array([5])],
    ids=repr,
)
def test_what_is_no_whole_number_is_refused_with_what_is_allowed(value):
    with pytest.raises(ValueError, match=rf"^size={re.escape(repr(value))}: give a whole number$"):
        whole("size", value)


@pytest.mark.parametrize(
    ("value", "bounds", "message"),
    [
        (1, (2, 9), "size=1: give a whole number from 2 to 9"),
        (np.int64(10), (2, 9), r"size=np.int64\(10\): give a whole number from 2 to 9"),
        (-1, (0,), "size=-1: give a whole number from 0 on"),
    ],
)
def test_a_number_out_of_bounds_is_refused_with_the_bounds(value, bounds, message):
    with pytest.raises(ValueError, match=f"^{message}$"):
        whole("size", value, *bounds)

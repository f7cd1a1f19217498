"""Slots: what a picture shows, whatever its palette, and what a slot becomes when it grows."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from labyrinth_core.learning.networks.slots import (
    Slots,
)
from labyrinth_core.pictures import DEFAULT_STYLE, render
from labyrinth_core.pictures.style import Style
from labyrinth_core.world import Labyrinth, State, Task, sample_labyrinth

RNG = np.random.default_rng(0)


def pixels_of(slots: Slots) -> NDArray[np.uint8]:
    """Return the slot of each pixel."""
    return slots.grid[slots.rows[:, None], slots.columns]


def number_of(colour: tuple[int, int, int]) -> int:
    red, green, blue = colour
    return red << 16 | green << 8 | blue


@pytest.fixture(scope="module", params=[(3, 3), (4, 6), (7, 7)])
def labyrinth(request: pytest.FixtureRequest) -> Labyrinth:
    return sample_labyrinth(*request.param, Task.NAVIGATION, np.random.default_rng(1))


def test_slots_are_the_pixels_of_a_picture_in_any_palette(labyrinth: Labyrinth) -> None:
    picture = render(labyrinth, State(labyrinth.start))
    slots = Slots.of(picture)
    colours = slots.colours[pixels_of(slots)]
    shown = np.stack([colours >> 16, colours >> 8 & 255, colours & 255], axis=2)
    assert np.array_equal(shown, picture)
    other = Style(*(tuple(each) for each in RNG.permutation(256)[:27].reshape(9, 3).tolist()))
    again = Slots.of(render(labyrinth, State(labyrinth.start), style=other))
    for same in ("grid", "rows", "columns"):
        assert np.array_equal(getattr(slots, same), getattr(again, same))
    assert not np.intersect1d(slots.colours, again.colours).size


@pytest.mark.parametrize("style", [DEFAULT_STYLE, Style(wall_pixels=2), Style(wall_pixels=20)])
def test_the_agent_is_in_its_cell(labyrinth: Labyrinth, style: Style) -> None:
    structure = labyrinth.structure
    for agent in range(structure.cells):
        slots = Slots.of(render(labyrinth, State(agent), style=style))
        row, column = divmod(agent, structure.width)
        cell = (structure.height - 1 - row) * structure.width + column
        size = structure.height, structure.width
        assert slots.cell_of(number_of(style.agent), *size) == cell
        number = int(np.flatnonzero(slots.colours == number_of(style.agent))[0])
        there = slots.scene(*size, 1) >> number & 1
        assert np.array_equal(np.flatnonzero(there), [cell])


@pytest.mark.parametrize("by", [0, 1, 7])
def test_a_slot_grows_over_the_others_and_pictures_shift(labyrinth: Labyrinth, by: int) -> None:
    slots = Slots.of(render(labyrinth, State(labyrinth.start)))
    before = pixels_of(slots)
    for slot in range(len(slots.colours)):
        around = np.pad(before == slot, by)
        mask = np.zeros_like(before, np.bool_)
        for down in range(2 * by + 1):
            for right in range(2 * by + 1):
                mask |= around[down:, right:][: len(mask), : len(mask)]
        after = slots.grown(slot, by)
        assert np.array_equal(pixels_of(after), np.where(mask, slot, before))
    moved = slots.shifted(by, -by)
    expected = np.pad(before, by, mode="edge")[: len(before), 2 * by :]
    assert np.array_equal(pixels_of(moved), expected)

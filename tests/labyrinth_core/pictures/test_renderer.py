"""The picture: what it shows, where, and that no two things in it look alike."""

import hashlib
import io
from dataclasses import fields, replace
from fractions import Fraction
from itertools import groupby, permutations
from math import floor
from random import Random

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image
from support.brute_force import (
    grid_passages,
    labyrinth_of,
    passages_of,
    reachable,
    sees,
    situations,
    structure_with,
    world_of,
)
from support.known_labyrinths import KEY_AND_DOOR
from support.strategies import labyrinths, randoms

from labyrinth_core.language import parse
from labyrinth_core.pictures import (
    DEFAULT_STYLE,
    MAX_PICTURED_SIDE,
    PICTURE_SIZE,
    ObservationSpec,
    Painter,
    render,
)
from labyrinth_core.pictures.resize import area_average
from labyrinth_core.pictures.style import Style
from labyrinth_core.world import Labyrinth, State, Structure, Task, sample_labyrinth

NAVIGATION = """
labyrinth:
-----------------
|   |         E |
|   +   + - +   |
|       |   |   |
| - + - +   +   |
| S             |
-----------------
end
"""
PARTIAL_OBSERVABILITY = """
occlusion: True

labyrinth:
-------------
|   |     E |
|   +   + - |
|           |
|   + - +   |
| S     |   |
-------------
end
"""
ICY_FLOOR = """
icy_floor: True

labyrinth:
-------------
|   |     E |
|   +   + - |
|         I |
|   + - +   |
| S   I   I |
-------------
end
"""
GOLDEN = (
    (NAVIGATION, State(0)),
    (NAVIGATION, State(11)),
    (PARTIAL_OBSERVABILITY, State(0)),
    (PARTIAL_OBSERVABILITY, State(4)),
    (KEY_AND_DOOR, State(0)),
    (KEY_AND_DOOR, State(2, True)),
    (KEY_AND_DOOR, State(7, True, True)),
    (KEY_AND_DOOR, State(8, True, True)),
    (ICY_FLOOR, State(3)),
    (ICY_FLOOR, State(1)),
)
"""Labyrinths and states whose pixels tests/data/pictures.json holds as hashes.

Other hashes mean other pixels. Then `just renew` writes them down; unless only colours are others,
`pictures.observations.PICTURES_VERSION` has to be increased.
"""

_STEP = 255 // len(fields(Style))
COLOURFUL = Style(
    *((_STEP * place, 255 - _STEP * place, 7 * place) for place in range(1, len(fields(Style))))
)
"""A colour of its own for everything."""


def states_of(labyrinth):
    """Return every state that the rules allow, also those that no route leads to."""
    width = labyrinth.structure.width
    return [
        State(row * width + column, has_key, door_open)
        for (row, column), has_key, door_open in situations(world_of(labyrinth))
    ]


def centre(structure, place):
    """Return the pixel (from the top, from the left) in the middle of a cell.

    All that is known of the picture here: cells are square, in the middle, and row 0 is lowest.
    """
    pitch = PICTURE_SIZE / max(structure.height, structure.width)
    row, column = place
    from_left = PICTURE_SIZE / 2 + (column + 0.5 - structure.width / 2) * pitch
    from_top = PICTURE_SIZE / 2 + (structure.height / 2 - row - 0.5) * pitch
    return int(from_top), int(from_left)


def seen_in(labyrinth, state):
    """Return the places that the agent sees."""
    world = world_of(labyrinth)
    if labyrinth.task is not Task.PARTIAL_OBSERVABILITY:
        return set(world.places())
    agent = divmod(state.agent, world.width)
    return {place for place in world.places() if sees(world.passages, agent, place)}


def shows_wall(picture, structure, place, beside):
    """Return whether there is a wall's colour on the way from one cell half way to the next."""
    here, there = centre(structure, place), centre(structure, beside)
    half_way = [(a + b) // 2 for a, b in zip(here, there, strict=True)]
    top, left = map(min, here, half_way)
    bottom, right = map(max, here, half_way)
    line = picture[top : bottom + 1, left : right + 1]
    return bool((line == DEFAULT_STYLE.wall).all(axis=-1).any())


# Bytes and sizes.


@pytest.mark.parametrize(("text", "state"), GOLDEN)
def test_the_pictures_are_the_ones_they_have_always_been(text, state, as_always):
    labyrinth = parse(text)
    pixels = b"".join(render(labyrinth, state, size).tobytes() for size in (PICTURE_SIZE, 64))
    name = f"{labyrinth.task}, {state}"
    as_always("pictures.json", name, hashlib.sha256(pixels).hexdigest()[:16])


@pytest.mark.slow
@settings(max_examples=40)
@given(labyrinths(), st.data())
def test_the_png_holds_the_very_pixels_of_the_array(labyrinth, data):
    state = data.draw(st.sampled_from(states_of(labyrinth)))
    picture, png = render(labyrinth, state), Painter(labyrinth).png(state)
    with Image.open(io.BytesIO(png)) as image:
        assert (image.mode, image.size) == ("RGB", (600, 600))
        np.testing.assert_array_equal(np.asarray(image), picture)
    (decoded,) = ObservationSpec("image", PICTURE_SIZE).decoded([png])
    np.testing.assert_array_equal(decoded, picture)


@pytest.mark.slow
@settings(max_examples=25)
@given(labyrinths(), randoms)
def test_a_painter_that_drew_other_states_draws_like_a_new_one(labyrinth, random):
    painter = Painter(labyrinth)
    states = states_of(labyrinth)
    for state in random.sample(states, min(len(states), 8)):
        fresh = Painter(labyrinth)
        assert painter.png(state) == fresh.png(state)
        np.testing.assert_array_equal(painter.array(state), fresh.array(state))
        np.testing.assert_array_equal(painter.array(state, 64), fresh.array(state, 64))


# What is where.


@settings(max_examples=60)
@given(labyrinths(), st.data())
def test_every_tile_is_in_the_middle_of_its_cell(labyrinth, data):
    world = world_of(labyrinth)
    state = data.draw(st.sampled_from(states_of(labyrinth)))
    structure, style = labyrinth.structure, COLOURFUL
    picture = render(labyrinth, state, style=style)
    agent = divmod(state.agent, structure.width)
    seen = seen_in(labyrinth, state)
    grounds = {
        labyrinth.position(cell): getattr(style, name)
        for name in labyrinth.task.rules.grounds
        for cell in getattr(labyrinth, name)
    }
    for place in world.places():
        shown = style.floor if place in seen else style.hidden
        if place == world.key and not state.has_key:
            shown = style.key
        if place == world.door and not state.door_open:
            shown = style.door
        shown = grounds.get(place, shown)
        if place == world.start:
            shown = style.start
        if place == world.goal:
            shown = style.goal
        if place == agent:
            shown = style.key if state.has_key and not state.door_open else style.agent
        assert tuple(picture[centre(structure, place)].tolist()) == shown


@settings(max_examples=60)
@given(labyrinths(Task.NAVIGATION, Task.PARTIAL_OBSERVABILITY), st.data())
def test_exactly_the_closed_passages_and_those_out_of_sight_are_drawn_as_walls(labyrinth, data):
    world, structure = world_of(labyrinth), labyrinth.structure
    state = data.draw(st.sampled_from(states_of(labyrinth)))
    picture, seen = render(labyrinth, state), seen_in(labyrinth, state)
    for pair in grid_passages(world.height, world.width):
        for place, beside in permutations(pair):
            if place in seen:
                is_open = pair in world.passages
                assert shows_wall(picture, structure, place, beside) == (not is_open)
            elif not pair & seen:
                assert shows_wall(picture, structure, place, beside)


@pytest.mark.parametrize(
    ("asked", "drawn"), [(1, 1), (2, 2), (12, 12), (13, 13), (37, 37), (38, 37), (600, 37)]
)
def test_walls_are_as_thick_as_asked_up_to_a_quarter_of_a_cell(asked, drawn):
    labyrinth = parse(NAVIGATION)  # Four columns: a cell has 150 pixels.
    picture = render(labyrinth, State(labyrinth.start), style=Style(wall_pixels=asked))
    middle = (picture == DEFAULT_STYLE.wall).all(axis=2)[450]  # Of the lowest row of cells.
    assert middle.argmin() == drawn


def test_an_open_door_keeps_its_frame_and_the_agent_loses_the_key_in_it():
    labyrinth = parse(KEY_AND_DOOR)
    with_key, opened = State(4, True), State(4, True, True)
    key, door = np.array(DEFAULT_STYLE.key), np.array(DEFAULT_STYLE.door)
    pictures = [render(labyrinth, state) for state in (State(4), with_key, opened)]
    keys = [(picture == key).all(axis=2).any() for picture in pictures]
    doors = [(picture == door).all(axis=2).sum() for picture in pictures]
    assert keys == [True, True, False]
    assert doors[0] == doors[1] > 2 * doors[2] > 0


@pytest.mark.parametrize(("height", "width"), [(4, 6), (6, 4), (2, 9), (10, 25)])
def test_cells_of_a_rectangle_are_square_with_the_margin_on_both_sides(height, width):
    labyrinth = sample_labyrinth(height, width, Task.NAVIGATION, np.random.default_rng(0))
    state = next(state for state in states_of(labyrinth) if state.agent != labyrinth.goal)
    picture = render(labyrinth, state, style=COLOURFUL)
    goal = np.nonzero((picture == COLOURFUL.goal).all(axis=2))
    tall, wide = (int(np.ptp(axis)) + 1 for axis in goal)
    assert abs(tall - wide) <= 1
    walls = np.nonzero((picture == COLOURFUL.wall).all(axis=2))
    most = max(height, width)
    for axis, count in zip(walls, (height, width), strict=True):
        before, after = int(axis.min()), PICTURE_SIZE - 1 - int(axis.max())
        assert abs(before - after) <= 1
        assert abs(before - (most - count) * PICTURE_SIZE / most / 2) <= PICTURE_SIZE / most / 12
    margin = picture[:, : walls[1].min()] if height > width else picture[: walls[0].min()]
    assert (margin == COLOURFUL.floor).all()


# Nothing looks like something else.


SIZES = [(3, 3), (4, 4), (5, 5), (10, 10), (25, 25), (30, 30), (4, 6)]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("height", "width", "task", "sizes"),
    [
        *(
            (*size, task, (PICTURE_SIZE, 64))
            for size in [*SIZES[:4], (4, 6), (2, 9)]
            for task in Task
        ),
        (25, 25, Task.KEY_AND_DOOR, (64,)),
    ],
)
def test_all_states_of_a_labyrinth_look_different(height, width, task, sizes):
    labyrinth = sample_labyrinth(height, width, task, np.random.default_rng(0))
    painter, states = Painter(labyrinth), states_of(labyrinth)
    for size in sizes:
        assert len({painter.array(state, size).tobytes() for state in states}) == len(states)


def open_and_closed(structure, pair):
    """Return two labyrinths that differ in one passage, with start and goal where they hurt not."""
    height, width = structure.height, structure.width
    without = passages_of(structure) - {pair}
    start, goal = sorted(min(without, key=lambda other: (bool(other & pair), sorted(other))))
    cells = [row * width + column for row, column in (start, goal)]
    return (
        Labyrinth(structure_with(height, width, passages), *cells)
        for passages in (without | {pair}, without)
    )


@pytest.mark.slow
@pytest.mark.parametrize(("height", "width"), SIZES)
def test_opening_or_closing_any_one_wall_shows(height, width):
    structure = next(Structure.sample(height, width, np.random.default_rng(0)))
    pairs = grid_passages(height, width)
    for pair in Random(0).sample(pairs, min(len(pairs), 60)):
        painters = [Painter(labyrinth) for labyrinth in open_and_closed(structure, pair)]
        for size in (PICTURE_SIZE, 64):
            pictures = [painter.array(State(0), size) for painter in painters]
            assert np.ptp(pictures, axis=0).max() >= 20, (pair, size)


# Partial observability.


@pytest.mark.slow
@settings(max_examples=60)
@given(labyrinths(Task.PARTIAL_OBSERVABILITY), st.data())
def test_a_wall_between_two_cells_out_of_sight_does_not_show(labyrinth, data):
    world = world_of(labyrinth)
    state = data.draw(st.sampled_from(states_of(labyrinth)))
    picture, seen = render(labyrinth, state), seen_in(labyrinth, state)
    for pair in grid_passages(world.height, world.width):
        changed = replace(world, passages=world.passages ^ {pair})
        if world.goal in reachable(changed.passages, world.start) and not pair & seen:
            other = labyrinth_of(changed, Task.PARTIAL_OBSERVABILITY)
            if seen_in(other, state) == seen:
                np.testing.assert_array_equal(render(other, state), picture)


# Large labyrinths.


def without_walls(height, width):
    return Labyrinth(Structure.without_walls(height, width), 0, height * width - 1)


def most_runs(dark):
    """Return the most runs of True that a line of the picture has."""
    return max(
        sum(value for value, _ in groupby(line)) for line in np.unique(dark, axis=0).tolist()
    )


@pytest.mark.slow
@pytest.mark.parametrize("side", [2, 3, 25, 100, 149, 150, 151, 200, 298, MAX_PICTURED_SIDE])
def test_every_wall_and_every_cell_has_a_pixel_in_each_direction(side):
    labyrinth = without_walls(side, side)
    # With all passages open, the posts between four cells stand apart, along each wall.
    dark = (render(labyrinth, State(0)) == DEFAULT_STYLE.wall).all(axis=2)
    assert most_runs(dark) == side + 1
    np.testing.assert_array_equal(dark, dark.T)


@pytest.mark.parametrize("side", [150, MAX_PICTURED_SIDE])
def test_the_agent_shows_wherever_it_is_in_a_large_labyrinth(side):
    labyrinth = without_walls(2, side)
    painter = Painter(labyrinth)
    middle = slice(PICTURE_SIZE // 2 - 5, PICTURE_SIZE // 2 + 5)
    places = []
    for cell in range(side):
        shown = (painter.array(State(cell))[middle] == DEFAULT_STYLE.agent).all(axis=2)
        assert shown.any()
        places.append(np.nonzero(shown)[1].mean())
    assert (np.diff(places) > 0).all()


@pytest.mark.parametrize(("height", "width"), [(300, 2), (2, 300)])
def test_a_labyrinth_without_a_pixel_for_each_cell_is_refused(height, width):
    with pytest.raises(ValueError, match=f"{height}x{width} labyrinth does not fit .* 299 rows"):
        render(without_walls(height, width), State(0))


# The average.


@pytest.mark.slow
@settings(max_examples=40)
@given(st.integers(1, 9), st.integers(1, 9), st.data())
def test_the_average_is_exact_for_any_two_sizes(side, size, data):
    pixels = data.draw(st.binary(min_size=3 * side**2, max_size=3 * side**2))
    picture = np.frombuffer(pixels, np.uint8).reshape(side, side, 3)
    # Each pixel as size x size small ones, of which side x side make a pixel of the result.
    small = picture.repeat(size, axis=0).repeat(size, axis=1).astype(int)
    sums = small.reshape(size, side, size, side, 3).sum(axis=(1, 3))
    means = [floor(Fraction(each, side**2) + Fraction(1, 2)) for each in sums.ravel().tolist()]
    assert area_average(picture, size).ravel().tolist() == means


def test_a_size_of_numpys_draws_the_same_and_what_is_no_size_is_refused():
    labyrinth = parse(KEY_AND_DOOR)
    state = State(labyrinth.start)
    assert (render(labyrinth, state, np.int64(48)) == render(labyrinth, state, 48)).all()
    assert ObservationSpec("image", np.uint8(48)) == ObservationSpec("image", 48)
    for size in (True, 0, 601, 48.0, "48"):
        refused = rf"^image_size={size!r}: give a whole number from 1 to 600$"
        with pytest.raises(ValueError, match=refused):
            render(labyrinth, state, size)
        with pytest.raises(ValueError, match=refused):
            ObservationSpec("image", size)
    with pytest.raises(ValueError, match=r"^wall_pixels=0: give a whole number from 1 on$"):
        render(labyrinth, state, style=Style(wall_pixels=0))

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
from brute_force import (
    grid_passages,
    labyrinth_of,
    passages_of,
    reachable,
    sees,
    situations,
    structure_with,
    world_of,
)
from hypothesis import given, settings
from hypothesis import strategies as st
from known_labyrinths import KEY_AND_DOOR
from PIL import Image
from strategies import labyrinths, randoms, structures

from labyrinth_core.language.text import parse
from labyrinth_core.pictures.renderer import (
    DEFAULT_STYLE,
    MAX_PICTURED_SIDE,
    PICTURE_SIZE,
    Painter,
    Style,
    render,
)
from labyrinth_core.pictures.resize import area_average
from labyrinth_core.world import tasks
from labyrinth_core.world.dynamics import State
from labyrinth_core.world.labyrinth import Labyrinth, LabyrinthError, Structure, Task
from labyrinth_core.world.sampling import sample_structures

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
GOLDEN = {
    (NAVIGATION, State(0)): (
        "ac2303f1bed8b6be40382f9d63b091ddc9af0342a403d3df6e59b4dd3d755bd5",
        "e7957273a383a86faa7d55a6825266750adec6a0ba9ca0df6af9368f99615c9a",
    ),
    (NAVIGATION, State(11)): (
        "5c6881d4f3c5aedfcf6fc51a65fca0d999b3e49f51872a8930b2eb7be04924b0",
        "32531c1b98e49460a6a807f6d6a5fe89a75f8347df19bfa677e74e08d7985542",
    ),
    (PARTIAL_OBSERVABILITY, State(0)): (
        "f71b80f4c24e2068729edcada0262aa9a317fe63f4fe24dd296f23567c55dfd3",
        "b44e488508b283c94dfece5137f47c6bf7fb8d8f13b7be0651811d51f196f1ba",
    ),
    (PARTIAL_OBSERVABILITY, State(4)): (
        "24ac77a7b99670441ab3360642924af50b1c7c892c2bdc9804368550044f9793",
        "49dd7224c0178fb9b0dabf1dc3d3f228107ab2aa9107f8aee2a1feca2242ac58",
    ),
    (KEY_AND_DOOR, State(0)): (
        "3aeef51c806a2178ceb84b331e1d0e0d3c319ac29ca59fb9c4eb9e3267b88c01",
        "a9688515b5cd213f00c6e7e545f9688c12bfcfd0b51303be05d7ea8579fcee39",
    ),
    (KEY_AND_DOOR, State(2, has_key=True)): (
        "924e45fca50bcbad565d6d9f52c71d7e29f6cab94596c09101ba9e4542c69d4e",
        "3a8aa33fa1c9fc6cff751b6c6a447d358e8d5e1496a7865c7a0e3603339abdec",
    ),
    (KEY_AND_DOOR, State(7, has_key=True, door_open=True)): (
        "b437f19bc847fdb99022f7a10b11a5efbb8d565eb5c0a5369885ef335b11cfd8",
        "5263db3504d6b19ae72f31dbd934ca9a610ba60d1e960273545e0fb14e40742e",
    ),
    (KEY_AND_DOOR, State(8, has_key=True, door_open=True)): (
        "c22a990785c34e07a733c0c12592d6e78a9a141843433d22bda7b13fd0c3959c",
        "dc4ceb3148402a255c9981a3cd2f443d3742bd93192113d859a5072bb63920e7",
    ),
    (ICY_FLOOR, State(3)): (
        "d1a18ccc407fbf73e7e93fa3a7d8ecb9c14b315f0cb2119f45b4caf8e917cec7",
        "2cb43c45d580fb44c93fb511e7ae1e9a9e31204e2a74d558a2eb85fc5d5adc17",
    ),
    (ICY_FLOOR, State(1)): (
        "1ae1a068bced3d14dce9320f648e26d18c5f511a535fefa828383b2055e029be",
        "034b0cf1665c3624fd8e0c4499397869e32d2c1aa363f680810e3eedc69ae598",
    ),
}
"""Labyrinth and state -> the SHA-256 of the pixels at 600 and at 64."""

COLOURFUL = Style(*((20 * place, 255 - 20 * place, 7 * place) for place in range(1, 10)))
"""A colour of its own for everything."""


def states_of(labyrinth):
    """Return every state that the rules allow, also those that no route leads to."""
    width = labyrinth.structure.width
    return [
        State(row * width + column, has_key, door_open)
        for (row, column), has_key, door_open in situations(world_of(labyrinth))
    ]


def some_labyrinth(height, width, task=Task.NAVIGATION):
    """Return a labyrinth of a size and task, the same each time."""
    rng = np.random.default_rng([height, width])
    structures = sample_structures(height, width, rng)
    while True:
        try:
            return tasks.place(next(structures), 0, height * width - 1, task, rng)
        except LabyrinthError:
            continue


def centre(structure, place):
    """Return the pixel (from the top, from the left) in the middle of a cell.

    All that is known of the picture here: cells are square, in the middle, and row 0 is lowest.
    """
    pitch = PICTURE_SIZE / max(structure.height, structure.width)
    row, column = place
    from_left = PICTURE_SIZE / 2 + (column + 0.5 - structure.width / 2) * pitch
    from_top = PICTURE_SIZE / 2 + (structure.height / 2 - row - 0.5) * pitch
    return int(from_top), int(from_left)


def colour_of(picture, structure, place):
    return tuple(picture[centre(structure, place)].tolist())


def shows_wall(picture, structure, place, beside, style=DEFAULT_STYLE):
    """Return whether there is a wall's colour on the way from one cell half way to the next."""
    here, there = centre(structure, place), centre(structure, beside)
    half_way = [(a + b) // 2 for a, b in zip(here, there, strict=True)]
    top, left = map(min, here, half_way)
    bottom, right = map(max, here, half_way)
    line = picture[top : bottom + 1, left : right + 1]
    return bool((line == style.wall).all(axis=-1).any())


# Bytes and sizes.


@pytest.mark.parametrize(("text", "state"), GOLDEN)
def test_the_pictures_are_the_ones_they_have_always_been(text, state):
    labyrinth = parse(text)
    pictures = (render(labyrinth, state, size) for size in (PICTURE_SIZE, 64))
    hashes = tuple(hashlib.sha256(picture.tobytes()).hexdigest() for picture in pictures)
    assert hashes == GOLDEN[text, state]


@pytest.mark.slow
@settings(max_examples=40)
@given(labyrinths(), st.data())
def test_the_png_holds_the_very_pixels_of_the_array(labyrinth, data):
    state = data.draw(st.sampled_from(states_of(labyrinth)))
    with Image.open(io.BytesIO(Painter(labyrinth).png(state))) as image:
        assert (image.mode, image.size) == ("RGB", (600, 600))
        np.testing.assert_array_equal(np.asarray(image), render(labyrinth, state))


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
    passages = passages_of(structure)
    for place in world.places():
        shown = style.floor
        if labyrinth.task is Task.PARTIAL_OBSERVABILITY and not sees(passages, agent, place):
            shown = style.hidden
        if place == world.key and not state.has_key:
            shown = style.key
        if place == world.door and not state.door_open:
            shown = style.door
        if place in world.ice:
            shown = style.ice
        if place == world.start:
            shown = style.start
        if place == world.goal:
            shown = style.goal
        if place == agent:
            shown = style.key if state.has_key and not state.door_open else style.agent
        assert colour_of(picture, structure, place) == shown


@settings(max_examples=60)
@given(structures(), st.data())
def test_exactly_the_closed_passages_are_drawn_as_walls(structure, data):
    passages = passages_of(structure)
    a, b = data.draw(st.sampled_from(sorted(map(sorted, passages)) or [None])) or (None, None)
    if a is None:
        return
    cells = (row * structure.width + column for row, column in (a, b))
    labyrinth = Labyrinth(structure, *cells)
    picture = render(labyrinth, State(labyrinth.start))
    for pair in grid_passages(structure.height, structure.width):
        for place, beside in permutations(pair):
            assert shows_wall(picture, structure, place, beside) == (pair not in passages)


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
    labyrinth = some_labyrinth(height, width)
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


@pytest.mark.slow
def test_every_colour_of_a_style_is_used_and_no_other():
    shown = set()
    drawn = [(NAVIGATION, State(0)), (PARTIAL_OBSERVABILITY, State(0)), (ICY_FLOOR, State(0))]
    drawn += [(KEY_AND_DOOR, state) for state in (State(4), State(4, True), State(7, True, True))]
    for text, state in drawn:
        lines = np.unique(render(parse(text), state, style=COLOURFUL), axis=0)
        shown |= set(map(tuple, lines.reshape(-1, 3).tolist()))
    colours = [field.name for field in fields(Style) if field.name != "wall_pixels"]
    assert shown == {getattr(COLOURFUL, name) for name in colours}


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
    labyrinth = some_labyrinth(height, width, task)
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


def largest_difference(first, second):
    return int(np.abs(first.astype(np.int16) - second).max())


@pytest.mark.slow
@pytest.mark.parametrize(("height", "width"), SIZES)
def test_opening_or_closing_any_one_wall_shows(height, width):
    structure = some_labyrinth(height, width).structure
    pairs = grid_passages(height, width)
    for pair in Random(0).sample(pairs, min(len(pairs), 400)):
        painters = [Painter(labyrinth) for labyrinth in open_and_closed(structure, pair)]
        for size in (PICTURE_SIZE, 64):
            pictures = [painter.array(State(0), size) for painter in painters]
            assert largest_difference(*pictures) >= 20, (pair, size)


# Partial observability.


def seen_from(world, agent):
    return {place for place in world.places() if sees(world.passages, agent, place)}


@pytest.mark.slow
@settings(max_examples=60)
@given(labyrinths(Task.PARTIAL_OBSERVABILITY), st.data())
def test_a_wall_between_two_cells_out_of_sight_does_not_show(labyrinth, data):
    world, structure = world_of(labyrinth), labyrinth.structure
    state = data.draw(st.sampled_from(states_of(labyrinth)))
    agent = divmod(state.agent, structure.width)
    picture = render(labyrinth, state)
    seen = seen_from(world, agent)
    for pair in grid_passages(world.height, world.width):
        changed = replace(world, passages=world.passages ^ {pair})
        solvable = world.goal in reachable(changed.passages, world.start)
        if solvable and not pair & seen and seen_from(changed, agent) == seen:
            other = labyrinth_of(changed, Task.PARTIAL_OBSERVABILITY)
            np.testing.assert_array_equal(render(other, state), picture)
            assert all(shows_wall(picture, structure, *way) for way in permutations(pair))


@pytest.mark.slow
@settings(max_examples=60)
@given(labyrinths(Task.PARTIAL_OBSERVABILITY), st.data())
def test_what_is_seen_looks_as_it_does_with_nothing_hidden(labyrinth, data):
    state = data.draw(st.sampled_from(states_of(labyrinth)))
    hidden = render(labyrinth, state)
    everything = render(replace(labyrinth, task=Task.NAVIGATION), state)
    differs = (hidden != everything).any(axis=2)
    assert (hidden[differs] == 0).all()
    world, structure = world_of(labyrinth), labyrinth.structure
    seen = seen_from(world, divmod(state.agent, structure.width))
    assert not any(differs[centre(structure, place)] for place in seen)
    for pair in grid_passages(world.height, world.width):
        for place, beside in permutations(pair):
            if place in seen:
                assert shows_wall(hidden, structure, place, beside) == (pair not in world.passages)


# Large labyrinths.


def all_open(height, width):
    cells = height * width
    up, right = (
        (1 << cells - width) - 1,
        sum(((1 << width - 1) - 1) << r for r in range(0, cells, width)),
    )
    return Labyrinth(Structure(height, width, up, right), 0, cells - 1)


def most_runs(dark):
    """Return the most runs of True that a line of the picture has."""
    return max(
        sum(value for value, _ in groupby(line)) for line in np.unique(dark, axis=0).tolist()
    )


@pytest.mark.slow
@pytest.mark.parametrize("side", [2, 3, 25, 100, 149, 150, 151, 200, 298, MAX_PICTURED_SIDE])
def test_every_wall_and_every_cell_has_a_pixel_in_each_direction(side):
    labyrinth = all_open(side, side)
    # With all passages open, the posts between four cells stand apart, along each wall.
    dark = (render(labyrinth, State(0)) == DEFAULT_STYLE.wall).all(axis=2)
    assert most_runs(dark) == side + 1
    np.testing.assert_array_equal(dark, dark.T)


@pytest.mark.parametrize("side", [150, MAX_PICTURED_SIDE])
def test_the_agent_shows_wherever_it_is_in_a_large_labyrinth(side):
    labyrinth = all_open(2, side)
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
        render(all_open(height, width), State(0))


# The average.


def exact_average(picture, size):
    """Return the rounded mean of what each pixel covers, by fractions, pixel by pixel."""
    side = len(picture)

    def covered(target):
        begin, end = Fraction(target * side, size), Fraction((target + 1) * side, size)
        for source in range(floor(begin), side):
            share = min(end, source + 1) - max(begin, source)
            if share <= 0:
                return
            yield source, share

    averaged = np.empty((size, size, 3), np.uint8)
    for row in range(size):
        for column in range(size):
            for channel in range(3):
                total = sum(
                    down * along * int(picture[y, x, channel])
                    for y, down in covered(row)
                    for x, along in covered(column)
                )
                mean = total / Fraction(side, size) ** 2
                averaged[row, column, channel] = floor(mean + Fraction(1, 2))
    return averaged


@pytest.mark.slow
@settings(max_examples=40)
@given(st.integers(1, 9), st.integers(1, 9), st.data())
def test_the_average_is_exact_for_any_two_sizes(side, size, data):
    pixels = data.draw(st.binary(min_size=3 * side**2, max_size=3 * side**2))
    picture = np.frombuffer(pixels, np.uint8).reshape(side, side, 3)
    np.testing.assert_array_equal(area_average(picture, size), exact_average(picture, size))


def test_the_average_rounds_halves_up():
    picture = np.zeros((2, 2, 3), np.uint8)
    picture[0, 0] = (2, 6, 1)
    assert area_average(picture, 1).tolist() == [[[1, 2, 0]]]

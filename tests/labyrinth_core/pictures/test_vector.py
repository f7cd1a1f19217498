"""The vector form: positions first, then the wall grid."""

import numpy as np
import pytest
from brute_force import sees
from hypothesis import given
from hypothesis import strategies as st
from known_labyrinths import SMALL_KEY_AND_DOOR as KEY_AND_DOOR
from strategies import labyrinths

from labyrinth_core.language.text import parse
from labyrinth_core.pictures.vector import (
    grid_index,
    grid_indices,
    initial_vectors,
    tile_count,
    vector_observation,
)
from labyrinth_core.world.batch_sampling import sample_each
from labyrinth_core.world.dynamics import State, initial, state_at, state_count
from labyrinth_core.world.labyrinth import Labyrinth, Task


def grid_of(vector, labyrinth):
    """Return the wall grid of a vector, and a function that says whether a passage is open."""
    structure = labyrinth.structure
    shape = (2 * structure.height - 1, 2 * structure.width - 1)
    return vector[tile_count(labyrinth.task) :].reshape(shape)


def passage(grid, labyrinth, cell, beside):
    (row, column), (row_beside, column_beside) = map(labyrinth.position, (cell, beside))
    return grid[row + row_beside, column + column_beside]


@st.composite
def situations(draw, *tasks):
    labyrinth = draw(labyrinths(*tasks))
    number = draw(st.integers(0, state_count(labyrinth) - 1))
    return labyrinth, state_at(labyrinth, number)


def test_a_vector_reads_as_its_drawing():
    labyrinth = parse(KEY_AND_DOOR)
    # Three cells and two passages a row, the bottom one first; key and door at (1, 0) and (1, 1).
    expected = [0, 0, 14, 10, 12, *(0, 0, 0, 0, 0), *(0, 1, 0, 1, 1), *(0, 1, 0, 0, 0)]
    assert vector_observation(labyrinth, initial(labyrinth)).tolist() == expected


def test_a_key_picked_up_and_a_door_opened_are_minus_one():
    labyrinth = parse(KEY_AND_DOOR)
    assert vector_observation(labyrinth, State(3, True))[:5].tolist() == [10, 0, 14, -1, 12]
    assert vector_observation(labyrinth, State(4, True, True))[:5].tolist() == [12, 0, 14, -1, -1]


@given(situations())
def test_its_length_and_type_follow_from_size_and_task(situation):
    labyrinth, state = situation
    vector = vector_observation(labyrinth, state)
    height, width = labyrinth.structure.height, labyrinth.structure.width
    tiles = 5 if labyrinth.task is Task.KEY_AND_DOOR else 3
    assert vector.shape == (tiles + (2 * height - 1) * (2 * width - 1),)
    assert vector.dtype == np.int32


@given(situations())
def test_positions_are_places_in_the_wall_grid(situation):
    labyrinth, state = situation
    structure = labyrinth.structure
    vector = vector_observation(labyrinth, state)
    places = np.arange(vector.size - tile_count(labyrinth.task)).reshape(
        2 * structure.height - 1, 2 * structure.width - 1
    )
    for entry, cell in zip(vector, (state.agent, labyrinth.start, labyrinth.goal), strict=False):
        row, column = labyrinth.position(cell)
        assert entry == places[2 * row, 2 * column] == grid_index(cell, structure.width)
        assert entry == grid_indices(structure.height, structure.width)[cell]


@given(situations(Task.NAVIGATION, Task.KEY_AND_DOOR, Task.ICY_FLOOR))
def test_the_wall_grid_is_open_exactly_where_there_is_a_passage(situation):
    labyrinth, state = situation
    structure = labyrinth.structure
    grid = grid_of(vector_observation(labyrinth, state), labyrinth)
    cells = [2 if cell in labyrinth.ice else 0 for cell in range(structure.cells)]
    assert grid[::2, ::2].ravel().tolist() == cells
    assert (grid[1::2, 1::2] == 1).all()
    for cell, beside in structure.passages():
        assert passage(grid, labyrinth, cell, beside) == 0
    walls = (grid[1::2, ::2] == 1).sum() + (grid[::2, 1::2] == 1).sum()
    borders = 2 * structure.cells - structure.height - structure.width
    assert walls == borders - len(list(structure.passages()))


@pytest.mark.slow
@given(situations(Task.PARTIAL_OBSERVABILITY))
def test_what_is_out_of_sight_looks_like_a_wall(situation):
    labyrinth, state = situation
    structure = labyrinth.structure
    grid = grid_of(vector_observation(labyrinth, state), labyrinth)
    places = [labyrinth.position(cell) for cell in range(structure.cells)]
    passages = frozenset(
        frozenset((places[cell], places[beside])) for cell, beside in structure.passages()
    )
    seen = {place for place in places if sees(passages, places[state.agent], place)}
    for row, column in places:
        shown = (row, column) in seen | {places[labyrinth.start], places[labyrinth.goal]}
        assert grid[2 * row, 2 * column] == (0 if shown else 1)
    for cell, beside in structure.passages():
        shown = places[cell] in seen or places[beside] in seen
        assert passage(grid, labyrinth, cell, beside) == (0 if shown else 1)
    hidden = grid_of(vector_observation(labyrinth, state), labyrinth)
    assert (hidden[1::2, 1::2] == 1).all()


def test_each_vector_is_the_callers_own():
    labyrinth = parse(KEY_AND_DOOR)
    first = vector_observation(labyrinth, initial(labyrinth))
    first[:] = 9
    assert vector_observation(labyrinth, initial(labyrinth)).max() < 15


def test_many_initial_vectors_are_those_of_each_labyrinth():
    structures = sample_each(3, 6, np.random.default_rng(0).spawn(20)).structures
    vectors = initial_vectors(structures, np.tile((2, 9), (len(structures), 1)))
    for place, vector in enumerate(vectors):
        labyrinth = Labyrinth(structures[place], 2, 9)
        np.testing.assert_array_equal(vector, vector_observation(labyrinth, initial(labyrinth)))

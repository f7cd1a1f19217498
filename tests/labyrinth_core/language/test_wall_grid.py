"""Wall grids: read back whatever was written, and mistakes with their place."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.known_labyrinths import GRID, LABYRINTH, changed
from support.strategies import labyrinths, structures

from labyrinth_core.language.wall_grid import from_connections, from_grid, to_grid
from labyrinth_core.world import Task


def test_the_array_shows_walls_start_and_goal_with_the_top_row_first():
    assert np.array_equal(to_grid(LABYRINTH), GRID)
    assert from_grid(GRID) == LABYRINTH


@given(labyrinths(Task.NAVIGATION), st.sampled_from([bool, np.int64, np.float32]))
def test_a_labyrinth_is_what_its_wall_grid_is_read_as(labyrinth, kind):
    grid = to_grid(labyrinth)
    inverted = np.where(grid < 2, 1 - grid.astype(int), grid)
    assert from_grid(grid) == from_grid(inverted) == labyrinth
    bare = np.where(grid > 1, 0, grid)
    assert from_grid(bare.astype(kind)) == labyrinth.structure
    assert from_grid((1 - bare).astype(kind)) == labyrinth.structure


def test_an_end_that_is_not_marked_is_where_the_language_has_it():
    assert from_grid(changed(3, 1, 0)) == from_grid(changed(1, 5, 0)) == LABYRINTH


@pytest.mark.parametrize(
    ("grid", "message"),
    [
        (GRID[:-1], r"4 x 7 elements, but a wall grid has 2h \+ 1 rows and 2w \+ 1 columns"),
        (GRID[:3], "3 x 7 elements"),
        (np.ones((2003, 5)), "2,003 x 5 elements"),
        (GRID[None], "1 x 5 x 7 elements"),
        (changed(2, 3, 4), "row 2, column 3: expected 0, 1, 2 for the start or 3 for the goal"),
        (GRID + np.where(GRID == 3, np.nan, 0), "row 1, column 5: expected 0, 1, 2"),
        (changed(0, 0, 2), "row 0, column 0: start and goal must be in cells"),
        (changed(0, 3, 0), "row 0, column 3: a gap in the outer wall"),
        (changed(2, 6, 3), "row 2, column 6: a gap in the outer wall"),
        (changed(2, 2, 0), "row 2, column 2: no wall where four cells meet"),
        (changed(1, 3, 1), "row 1, column 3: a wall where a cell is"),
        (changed(2, 3, 2), "row 2, column 3: start and goal must be in cells"),
        (changed(3, 3, 2), "row 3, column 3: a second start: mark at most one"),
        (changed(3, 5, 3), "row 3, column 5: a second goal: mark at most one"),
    ],
)
def test_what_is_no_wall_grid_is_refused_with_its_place(grid, message):
    with pytest.raises(ValueError, match=f"^{message}"):
        from_grid(grid)


def connections_of(structure):
    """Return the connections of a structure as maze-dataset has them."""
    height, width = structure.height, structure.width
    connections = np.zeros((2, height, width), np.bool_)
    for cell, neighbour in structure.passages():
        beside = neighbour == cell + 1
        place = cell if beside else neighbour
        connections[(int(beside), height - 1 - place // width, place % width)] = True
    return connections


@given(structures())
def test_connections_are_the_passages_of_the_structure(structure):
    assert from_connections(connections_of(structure)) == structure


@pytest.mark.parametrize(
    ("connections", "message"),
    [
        (np.zeros((1, 2, 2)), r"its connections have the shape \(1, 2, 2\): expected \(2, rows"),
        (np.zeros((2, 1, 5)), "its connections have the shape"),
        (np.full((2, 2, 2), 2), "its connections are not all 0 or 1"),
        (np.array([[[0, 0], [1, 0]], [[0, 0], [0, 0]]]), "a passage leads out of the grid"),
        (np.array([[[0, 0], [0, 0]], [[0, 1], [0, 0]]]), "a passage leads out of the grid"),
    ],
)
def test_connections_of_another_form_are_refused(connections, message):
    with pytest.raises(ValueError, match=f"^{message}"):
        from_connections(connections)

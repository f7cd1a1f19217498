"""Wall grids as arrays and as pictures: read back whatever was written, and mistakes with place."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image
from strategies import labyrinths, structures
from wall_grids import COLOURS, GRID, LABYRINTH, changed, inverted, png_of

from labyrinth_core.language import wall_picture
from labyrinth_core.language.wall_grid import from_grid, labyrinth_of, structure_of, to_grid
from labyrinth_core.language.wall_picture import from_picture
from labyrinth_core.world.labyrinth import Labyrinth, LabyrinthError, Task


def test_the_array_shows_walls_start_and_goal_with_the_top_row_first():
    assert np.array_equal(to_grid(LABYRINTH), GRID)
    assert from_grid(GRID) == LABYRINTH


@given(labyrinths(Task.NAVIGATION), st.sampled_from([bool, np.int64, np.float32]))
def test_a_labyrinth_is_what_its_wall_grid_is_read_as(labyrinth, kind):
    grid = to_grid(labyrinth)
    assert from_grid(grid) == from_grid(inverted(grid)) == labyrinth
    bare = np.where(grid > 1, 0, grid)
    assert from_grid(bare.astype(kind)) == labyrinth.structure
    assert from_grid((1 - bare).astype(kind)) == labyrinth.structure


@given(structures())
def test_passages_that_are_given_by_their_rows_from_the_top_are_those_of_the_structure(structure):
    height, width = structure.height, structure.width
    below = np.zeros((height - 1, width), np.bool_)
    beside = np.zeros((height, width - 1), np.bool_)
    for cell, neighbour in structure.passages():
        row, column = height - 1 - cell // width, cell % width
        if neighbour == cell + 1:
            beside[row, column] = True
        else:
            below[row - 1, column] = True
    assert structure_of(below, beside) == structure


@given(labyrinths(), st.integers(1, 4))
def test_a_labyrinth_is_what_the_picture_of_its_wall_grid_is_read_as(labyrinth, scale):
    expected = Labyrinth(labyrinth.structure, labyrinth.start, labyrinth.goal)
    grid = to_grid(labyrinth)
    palette = Image.fromarray(grid)
    palette.putpalette(COLOURS.tobytes())
    for pixels in (COLOURS[grid], COLOURS[inverted(grid)], palette):
        assert from_picture(png_of(pixels, scale)) == expected
    bare = Image.fromarray(np.where(grid == 1, 0, 255).astype(np.uint8))
    for mode in ("L", "1", "RGBA"):
        assert from_picture(png_of(bare.convert(mode), scale)) == labyrinth.structure


def test_a_route_that_is_drawn_in_a_picture_is_open():
    grid = changed(3, slice(3, 5), 4)
    assert from_picture(png_of(COLOURS[grid])) == LABYRINTH
    assert from_picture(png_of(COLOURS[[1, 0, 2, 3, 4]][grid])) == LABYRINTH


def test_an_end_that_is_not_marked_is_where_the_language_has_it():
    assert from_grid(changed(3, 1, 0)) == from_grid(changed(1, 5, 0)) == LABYRINTH
    assert labyrinth_of(LABYRINTH.structure, None, None) == LABYRINTH.structure


@pytest.mark.parametrize(
    ("grid", "message"),
    [
        (GRID[:-1], r"4 x 7 elements, but a wall grid has 2h \+ 1 rows and 2w \+ 1 columns"),
        (GRID[:3], "3 x 7 elements"),
        (np.ones((2003, 5)), "2,003 x 5 elements"),
        (GRID[None], "1 x 5 x 7 elements"),
        (changed(2, 3, 4), "row 2, column 3: expected 0, 1, 2 for the start or 3 for the goal"),
        (GRID + np.where(GRID == 3, np.nan, 0), "row 1, column 5: expected 0, 1, 2"),
        (changed(0, 0, 2), "row 0, column 0: start and goal are marked in cells"),
        (changed(0, 3, 0), "row 0, column 3: a gap in the outer wall"),
        (changed(2, 6, 3), "row 2, column 6: a gap in the outer wall"),
        (changed(2, 2, 0), "row 2, column 2: no wall where four cells meet"),
        (changed(1, 3, 1), "row 1, column 3: a wall where a cell is"),
        (changed(2, 3, 2), "row 2, column 3: start and goal are marked in cells"),
        (changed(3, 3, 2), "row 3, column 3: another start: at most one is marked"),
        (changed(3, 5, 3), "row 3, column 5: another goal: at most one is marked"),
    ],
)
def test_what_is_no_wall_grid_is_refused_with_its_place(grid, message):
    with pytest.raises(ValueError, match=f"^{message}"):
        from_grid(grid)


def test_a_goal_that_cannot_be_reached_is_refused():
    with pytest.raises(LabyrinthError, match="no route leads from start to goal"):
        from_grid(changed(3, 4, 1))


def test_a_mistake_in_a_picture_is_told_with_its_pixel():
    with pytest.raises(ValueError, match=r"^row 0, column 9: a gap in the outer wall"):
        from_picture(png_of(COLOURS[changed(0, 3, 0)], 3))
    grey = COLOURS[GRID]
    grey[2, 3] = 128
    expected = "^row 4, column 6: expected black, white, .*, found #808080$"
    with pytest.raises(ValueError, match=expected):
        from_picture(png_of(grey, 2))


def test_a_picture_of_another_shape_is_refused():
    with pytest.raises(ValueError, match=r"^4 x 7 elements, but a wall grid has 2h \+ 1 rows"):
        from_picture(png_of(COLOURS[GRID[:-1]], 3))


def test_a_picture_whose_walls_are_thinner_than_its_cells_is_refused():
    thin = np.repeat(np.repeat(COLOURS[GRID], [1, 3] * 2 + [1], 0), [1, 3] * 3 + [1], 1)
    with pytest.raises(ValueError, match=r"^row 2, column 2: no wall where four cells meet"):
        from_picture(png_of(thin))


def test_a_file_that_is_no_picture_or_damaged_or_too_large_is_refused(monkeypatch):
    png = png_of(COLOURS[GRID])
    with pytest.raises(ValueError, match=r"^no PNG file$"):
        from_picture(b"GIF89a" + bytes(100))
    with pytest.raises(ValueError, match=r"^a damaged PNG file$"):
        from_picture(png[:60])
    monkeypatch.setattr(wall_picture, "MAX_PIXELS", 34)
    with pytest.raises(ValueError, match=r"^7 x 5 pixels are more than 34$"):
        from_picture(png)

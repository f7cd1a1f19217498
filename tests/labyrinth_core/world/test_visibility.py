"""What the agent sees: straight and diagonal rays, as far as nothing breaks them."""

import numpy as np
from brute_force import passages_of, sees
from hypothesis import given
from strategies import structures

from labyrinth_core.world.labyrinth import Structure
from labyrinth_core.world.visibility import seen_together, visible_from


@given(structures())
def test_exactly_the_places_on_unbroken_lines_of_sight_are_seen(structure):
    passages, width = passages_of(structure), structure.width
    for cell in range(structure.cells):
        expected = {
            target
            for target in range(structure.cells)
            if sees(passages, divmod(cell, width), divmod(target, width))
        }
        assert visible_from(structure, cell) == expected


def test_a_cell_can_see_another_that_does_not_see_it():
    """A diagonal goes to the side first, as docs/make.md says; here that way has no wall."""
    structure = Structure.from_passages(2, 2, [(0, 1), (1, 3)])
    assert 3 in visible_from(structure, 0)
    assert 0 not in visible_from(structure, 3)


@given(structures())
def test_many_agents_at_once_see_what_each_of_them_sees(structure):
    cells = structure.cells
    first = cells * np.arange(cells)  # An agent in each cell, in a copy of the structure.
    moves = (np.array(structure.moves) + first[:, None, None]).reshape(-1, 4)
    agents = first + np.arange(cells)
    seen = seen_together(moves, agents, max(structure.height, structure.width))
    for cell, row in enumerate(seen.reshape(cells, cells)):
        assert set(np.flatnonzero(row)) == visible_from(structure, cell)

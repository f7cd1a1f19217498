"""The vector form: positions first, then the wall grid."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from support.brute_force import passages_of, sees, world_of
from support.strategies import labyrinths

from labyrinth_core.pictures import ObservationSpec
from labyrinth_core.world import Task


def expected(labyrinth, state):
    """Return the vector by the rules: all that is seen is open, or ice, and the rest is wall."""
    world, passages = world_of(labyrinth), passages_of(labyrinth.structure)
    agent = divmod(state.agent, world.width)
    hides = labyrinth.task is Task.PARTIAL_OBSERVABILITY
    seen = {place for place in world.places() if not hides or sees(passages, agent, place)}
    grid = np.ones((2 * world.height - 1, 2 * world.width - 1), int)
    grounds = {
        labyrinth.position(cell): entry
        for entry, name in enumerate(labyrinth.task.rules.grounds, start=2)
        for cell in getattr(labyrinth, name)
    }
    for row, column in seen | {world.start, world.goal}:
        grid[2 * row, 2 * column] = grounds.get((row, column), 0)
    for one, other in passages:
        if {one, other} & seen:
            grid[one[0] + other[0], one[1] + other[1]] = 0
    tiles = [agent, world.start, world.goal]
    if labyrinth.task is Task.KEY_AND_DOOR:
        tiles += [None if state.has_key else world.key, None if state.door_open else world.door]
    numbers = np.arange(grid.size).reshape(grid.shape)
    positions = [-1 if each is None else numbers[2 * each[0], 2 * each[1]] for each in tiles]
    return [*positions, *grid.ravel().tolist()]


@given(labyrinths(), st.data())
def test_a_vector_has_the_positions_and_what_is_seen_of_the_walls(labyrinth, data):
    state = labyrinth.state_at(data.draw(st.integers(0, labyrinth.state_count - 1)))
    (vector,) = ObservationSpec("vector").look([(labyrinth, state)])
    assert vector.dtype == np.int32
    assert vector.tolist() == expected(labyrinth, state)

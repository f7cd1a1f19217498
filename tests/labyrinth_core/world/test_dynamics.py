"""What a step does, in every task."""

import pytest
from brute_force import is_over, situations, step, world_of
from hypothesis import given
from strategies import labyrinths

from labyrinth_core.world.dynamics import (
    State,
    initial,
    reward,
    state_at,
    state_count,
    state_index,
    step_limit,
    transition,
    transition_table,
)
from labyrinth_core.world.grid import Action


def state_of(world, situation):
    """Return the library's state for a situation."""
    (row, column), has_key, door_open = situation
    return State(row * world.width + column, has_key, door_open)


@given(labyrinths())
def test_every_state_has_a_number_of_its_own(labyrinth):
    numbers = range(state_count(labyrinth))
    states = [state_at(labyrinth, number) for number in numbers]
    assert [state_index(labyrinth, state) for state in states] == list(numbers)
    world = world_of(labyrinth)
    allowed = {state_of(world, situation) for situation in situations(world)}
    assert allowed <= set(states)
    # The agent is never in a closed door, nor on the key without it: those three mean nothing.
    assert len(states) - len(allowed) == (3 if world.door else 0)
    assert state_index(labyrinth, initial(labyrinth)) == labyrinth.start


@given(labyrinths())
def test_the_transition_table_is_transition_by_numbers(labyrinth):
    world, table = world_of(labyrinth), transition_table(labyrinth)
    assert len(table) == state_count(labyrinth)
    for situation in situations(world):
        state = state_of(world, situation)
        row = table[state_index(labyrinth, state)]
        for action in Action:
            assert state_at(labyrinth, row[action]) == transition(labyrinth, state, action)
            if not is_over(world, situation):
                expected = state_of(world, step(world, situation, action)[0])
                assert state_at(labyrinth, row[action]) == expected


@given(labyrinths())
def test_an_episode_of_forty_steps_a_cell_without_the_goal_returns_minus_four(labyrinth):
    assert step_limit(labyrinth) == 40 * len(world_of(labyrinth).places())
    each = reward(labyrinth, initial(labyrinth))
    assert sum([each] * step_limit(labyrinth)) == pytest.approx(-4.0)

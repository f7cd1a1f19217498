"""What a step does, in every task."""

import pytest
from brute_force import drawn, is_over, labyrinth_of, situations, step, world_of
from hypothesis import given
from hypothesis import strategies as st
from strategies import labyrinths

from labyrinth_core.world.dynamics import (
    State,
    initial,
    is_terminal,
    reward,
    state_at,
    state_count,
    state_index,
    step_limit,
    transition,
    transition_table,
)
from labyrinth_core.world.grid import Action
from labyrinth_core.world.labyrinth import Task

UP, RIGHT, DOWN, LEFT = Action
actions = st.lists(st.integers(0, 3), max_size=60)

CORRIDORS = drawn(
    """
    -------------
    |   |   | E |
    | - +   +   |
    |           |
    |   + - +   |
    | S | I     |
    -------------
    """
)

LOCKED = drawn(
    """
    -------------
    |   | D   E |
    |   +   + - |
    |           |
    |   + - +   |
    | S |     K |
    -------------
    """
)


def state_of(world, situation):
    """Return the library's state for a situation."""
    (row, column), has_key, door_open = situation
    return State(row * world.width + column, has_key, door_open)


def after(labyrinth, *route):
    state = initial(labyrinth)
    for action in route:
        state = transition(labyrinth, state, action)
    return state


# Properties.


@given(labyrinths(), actions)
def test_walking_gives_the_situations_and_rewards_that_the_rules_say(labyrinth, route):
    world = world_of(labyrinth)
    situation, state = (world.start, False, False), initial(labyrinth)
    for action in route:
        situation, expected, over = step(world, situation, action)
        state = transition(labyrinth, state, action)
        assert state == state_of(world, situation)
        assert reward(labyrinth, state) == pytest.approx(expected, abs=1e-12)
        assert is_terminal(labyrinth, state) == over
        if over:
            break


@given(labyrinths())
def test_every_state_has_a_number_of_its_own(labyrinth):
    numbers = range(state_count(labyrinth))
    states = [state_at(labyrinth, number) for number in numbers]
    assert [state_index(labyrinth, state) for state in states] == list(numbers)
    world = world_of(labyrinth)
    allowed = {state_of(world, situation) for situation in situations(world)}
    assert allowed <= set(states)
    # Nobody stands in a closed door, nor on the key without it: those three mean nothing.
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
def test_an_episode_begins_on_the_start_without_key_and_before_a_closed_door(labyrinth):
    state = initial(labyrinth)
    assert state == State(labyrinth.start, has_key=False, door_open=False)
    assert not is_terminal(labyrinth, state)


@given(labyrinths())
def test_an_episode_of_forty_steps_a_cell_without_the_goal_returns_minus_four(labyrinth):
    assert step_limit(labyrinth) == 40 * len(world_of(labyrinth).places())
    each = reward(labyrinth, initial(labyrinth))
    assert sum([each] * step_limit(labyrinth)) == pytest.approx(-4.0)


# Examples.


def test_a_passage_lets_the_agent_through_and_a_wall_does_not():
    labyrinth = labyrinth_of(CORRIDORS, Task.ICY_FLOOR)
    assert after(labyrinth, UP) == State(3)
    assert after(labyrinth, UP, RIGHT) == State(4)
    assert after(labyrinth, UP, RIGHT, UP) == State(7)
    assert after(labyrinth, RIGHT) == State(0)
    assert after(labyrinth, UP, UP) == State(3)
    assert after(labyrinth, DOWN) == State(0)
    assert after(labyrinth, LEFT) == State(0)


def test_a_step_that_does_not_end_on_the_goal_costs_a_tenth_over_the_cells():
    labyrinth = labyrinth_of(CORRIDORS, Task.ICY_FLOOR)
    for bump_or_move in (UP, LEFT):
        assert reward(labyrinth, after(labyrinth, bump_or_move)) == pytest.approx(-0.1 / 9)


def test_the_goal_pays_one_and_ends_the_episode():
    labyrinth = labyrinth_of(CORRIDORS, Task.ICY_FLOOR)
    state = after(labyrinth, UP, RIGHT, RIGHT, UP)
    assert state == State(8)
    assert reward(labyrinth, state) == 1.0
    assert is_terminal(labyrinth, state)


def test_ice_costs_a_hundred_and_ends_the_episode():
    labyrinth = labyrinth_of(CORRIDORS, Task.ICY_FLOOR)
    state = after(labyrinth, UP, RIGHT, RIGHT, DOWN, LEFT)
    assert state == State(1)
    assert reward(labyrinth, state) == -100.0
    assert is_terminal(labyrinth, state)


def test_a_bump_into_a_wall_with_ice_behind_it_is_a_bump_like_any_other():
    labyrinth = labyrinth_of(CORRIDORS, Task.ICY_FLOOR)
    from_the_side = after(labyrinth, RIGHT)
    from_above = after(labyrinth, UP, RIGHT, DOWN)
    assert (from_the_side, from_above) == (State(0), State(4))
    for state in (from_the_side, from_above):
        assert reward(labyrinth, state) == pytest.approx(-0.1 / 9)
        assert not is_terminal(labyrinth, state)


def test_a_door_is_a_wall_to_whom_has_no_key():
    labyrinth = labyrinth_of(LOCKED, Task.KEY_AND_DOOR)
    before_the_door = after(labyrinth, UP, RIGHT)
    assert transition(labyrinth, before_the_door, UP) == before_the_door == State(4)
    assert reward(labyrinth, before_the_door) == pytest.approx(-0.1 / 9)


def test_entering_the_cell_of_the_key_picks_it_up_for_good():
    labyrinth = labyrinth_of(LOCKED, Task.KEY_AND_DOOR)
    route = (UP, RIGHT, RIGHT, DOWN)
    assert not after(labyrinth, *route[:3]).has_key
    assert after(labyrinth, *route) == State(2, has_key=True)
    assert after(labyrinth, *route, UP, LEFT) == State(4, has_key=True)


def test_the_key_opens_the_door_for_good():
    labyrinth = labyrinth_of(LOCKED, Task.KEY_AND_DOOR)
    route = (UP, RIGHT, RIGHT, DOWN, UP, LEFT, UP)
    assert after(labyrinth, *route) == State(7, has_key=True, door_open=True)
    assert after(labyrinth, *route, DOWN) == State(4, has_key=True, door_open=True)
    assert after(labyrinth, *route, DOWN, UP, RIGHT) == State(8, has_key=True, door_open=True)


def test_a_labyrinth_remembers_nothing_from_one_episode_to_the_next():
    labyrinth = labyrinth_of(LOCKED, Task.KEY_AND_DOOR)
    after(labyrinth, UP, RIGHT, RIGHT, DOWN, UP, LEFT, UP)
    assert initial(labyrinth) == State(0)
    assert after(labyrinth, UP, RIGHT, UP) == State(4)

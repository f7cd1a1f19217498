"""What a step does in every task, what the agent sees, and what a route leaves behind."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.brute_force import (
    WAYS,
    chi_square,
    is_over,
    passages_of,
    sees,
    situations,
    step,
    world_of,
)
from support.strategies import labyrinths, structures

from labyrinth_core.world import Action, Episode, Labyrinth, Solver, State, Structure, seen_together


def state_of(world, situation):
    """Return the library's state for a situation."""
    (row, column), has_key, door_open = situation
    return State(row * world.width + column, has_key, door_open)


@given(st.integers(2, 12), st.integers(2, 12), st.data())
def test_an_action_leads_to_the_neighbour_in_its_direction(height, width, data):
    cell = data.draw(st.integers(0, height * width - 1))
    row, column = divmod(cell, width)
    expected = [
        (row + rows) * width + column + columns
        if 0 <= row + rows < height and 0 <= column + columns < width
        else cell
        for rows, columns in map(WAYS.__getitem__, Action)
    ]
    assert Structure.without_walls(height, width).moves[cell] == (*expected,)


@given(labyrinths())
def test_every_state_has_a_number_of_its_own(labyrinth):
    numbers = range(labyrinth.state_count)
    states = [labyrinth.state_at(number) for number in numbers]
    assert [labyrinth.state_index(state) for state in states] == list(numbers)
    world = world_of(labyrinth)
    allowed = {state_of(world, situation) for situation in situations(world)}
    assert allowed <= set(states)
    # The agent is never in a closed door, nor on the key without it: those three mean nothing.
    assert len(states) - len(allowed) == (3 if world.door else 0)
    assert labyrinth.state_index(labyrinth.initial) == labyrinth.start


@given(labyrinths())
def test_the_transition_table_is_transition_by_numbers(labyrinth):
    world, table = world_of(labyrinth), labyrinth.transition_table()
    assert len(table) == labyrinth.state_count
    for situation in situations(world):
        state = state_of(world, situation)
        row = table[labyrinth.state_index(state)]
        for action in Action:
            assert labyrinth.state_at(row[action]) == labyrinth.transition(state, action)
            if not is_over(world, situation):
                expected = state_of(world, step(world, situation, action)[0])
                assert labyrinth.state_at(row[action]) == expected


@given(labyrinths())
def test_an_episode_of_forty_steps_a_cell_without_the_goal_returns_minus_four(labyrinth):
    assert labyrinth.step_limit == 40 * len(world_of(labyrinth).places())
    each = labyrinth.reward(labyrinth.initial)
    assert sum([each] * labyrinth.step_limit) == pytest.approx(-4.0)


# Episodes.

seeds = st.integers(0, 2**32 - 1)
actions = st.lists(st.integers(0, 3), max_size=60)

ROOM = Labyrinth(Structure.without_walls(2, 2), 0, 3)


def until_over(world, route):
    """Return what the rules say the route visits and pays, cut where the episode is over."""
    situations, rewards = [(world.start, False, False)], []
    for action in route:
        situation, reward, over = step(world, situations[-1], action)
        situations.append(situation)
        rewards.append(reward)
        if over:
            break
    return situations, rewards


@given(labyrinths(), actions)
def test_a_replay_visits_and_pays_what_the_rules_say(labyrinth, route):
    world = world_of(labyrinth)
    situations, rewards = until_over(world, route)
    episode = labyrinth.replay(route[: len(rewards)])
    assert episode.labyrinth is labyrinth
    assert [
        (divmod(state.agent, world.width), state.has_key, state.door_open)
        for state in episode.states
    ] == situations
    assert episode.actions.tolist() == route[: len(rewards)]
    assert episode.rewards.tolist() == [np.float32(reward) for reward in rewards]
    assert (episode.actions.dtype, episode.rewards.dtype) == (np.int8, np.float32)
    assert not episode.actions.flags.writeable
    assert not episode.rewards.flags.writeable
    assert len(episode) == len(rewards) == len(episode.states) - 1
    assert episode.terminated == (situations[-1][0] in {world.goal, *world.ice})


@given(labyrinths(), st.lists(st.integers(0, 3), min_size=1, max_size=60))
def test_an_action_after_the_end_of_the_episode_is_refused(labyrinth, more):
    route = [*Solver(labyrinth).shortest_route(np.random.default_rng(0)), *more]
    steps = len(route) - len(more)
    assert labyrinth.replay(route[:steps]).terminated
    with pytest.raises(ValueError, match=f"^the episode ends after {steps} steps, but an action"):
        labyrinth.replay(route)


@pytest.mark.parametrize("action", [-1, 4, 255])
def test_an_action_that_is_none_of_the_four_is_refused(action):
    with pytest.raises(ValueError, match=f"^action {action}: the actions are 0, 1, 2 and 3"):
        ROOM.replay([0, action])


@pytest.mark.parametrize(("actions", "rewards"), [(2, 3), (3, 2), (4, 4), (2, 2)])
def test_an_episode_has_one_action_and_one_reward_for_each_state_but_the_last(actions, rewards):
    states = (State(0), State(0), State(0), State(0))
    with pytest.raises(
        ValueError, match=f"^an episode of 4 states has 3 .*{actions} and {rewards}"
    ):
        Episode(ROOM, states, np.zeros(actions, np.int8), np.zeros(rewards, np.float32))
    assert len(Episode(ROOM, states, np.zeros(3, np.int8), np.zeros(3, np.float32))) == 3


@given(labyrinths(), seeds, st.integers(0, 300))
def test_a_random_episode_ends_at_its_first_end_or_is_cut(labyrinth, seed, max_steps):
    episode = Episode.random(labyrinth, np.random.default_rng(seed), max_steps)
    assert len(episode) <= max_steps
    assert episode.terminated or len(episode) == max_steps
    assert not any(labyrinth.is_terminal(state) for state in episode.states[:-1])
    for action, (state, after) in zip(episode.actions, pairwise(episode.states), strict=True):
        assert labyrinth.transition(state, action) == after


def test_random_episodes_take_each_action_as_often_as_the_others():
    rng = np.random.default_rng(7)
    firsts = [int(Episode.random(ROOM, rng, 1).actions[0]) for _ in range(4000)]
    counts = np.bincount(firsts, minlength=4)
    assert len(counts) == 4
    assert chi_square(counts.tolist(), [1000] * 4) < 5


# Sight.


@given(structures())
def test_exactly_the_places_on_unbroken_lines_of_sight_are_seen(structure):
    passages, width = passages_of(structure), structure.width
    for cell in range(structure.cells):
        expected = {
            target
            for target in range(structure.cells)
            if sees(passages, divmod(cell, width), divmod(target, width))
        }
        assert structure.visible_from(cell) == expected


def test_a_cell_can_see_another_that_does_not_see_it():
    """A diagonal goes to the side first, as docs/make.md says; here that way has no wall."""
    structure = Structure.from_passages(2, 2, [(0, 1), (1, 3)])
    assert 3 in structure.visible_from(0)
    assert 0 not in structure.visible_from(3)


@given(structures())
def test_many_agents_at_once_see_what_each_of_them_sees(structure):
    cells = structure.cells
    first = cells * np.arange(cells)  # An agent in each cell, in a copy of the structure.
    moves = (np.array(structure.moves) + first[:, None, None]).reshape(-1, 4)
    agents = first + np.arange(cells)
    seen = seen_together(moves, agents, max(structure.height, structure.width))
    for cell, row in enumerate(seen.reshape(cells, cells)):
        assert set(np.flatnonzero(row)) == structure.visible_from(cell)

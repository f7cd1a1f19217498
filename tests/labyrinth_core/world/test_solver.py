"""Optimal behaviour, against brute force over every situation of the rules."""

import sys
from collections import Counter

import numpy as np
import pytest
from brute_force import (
    all_structures,
    best_actions,
    chi_square,
    drawn,
    is_connected,
    labyrinth_of,
    moves_to_go,
    passages_of,
    shortest_of,
    situations,
    step,
    world_of,
)
from brute_force import simple_routes as brute_simple_routes
from hypothesis import given
from hypothesis import strategies as st
from strategies import labyrinths

from labyrinth_core.world.dynamics import (
    State,
    state_count,
    state_index,
    transition_table,
)
from labyrinth_core.world.labyrinth import UNREACHABLE, Labyrinth, LabyrinthError, Structure, Task
from labyrinth_core.world.rollout import replay
from labyrinth_core.world.sampling import sample_structures
from labyrinth_core.world.solver import (
    distances,
    moves_and_routes,
    optimal_actions,
    shortest_route,
    shortest_routes,
    simple_routes,
)
from labyrinth_core.world.tasks import place

seeds = st.integers(0, 2**32 - 1)


def without_walls(height, width):
    return Labyrinth(Structure.without_walls(height, width), 0, height * width - 1)


def sampled(task, count, seed, sizes):
    """Return labyrinths of a task from the library's own sampler, any start, any goal."""
    rng = np.random.default_rng(seed)
    found = []
    for _ in range(1000 * count):
        height, width = sizes[rng.integers(len(sizes))]
        open_walls = float(rng.choice([0.0, 0.1, 0.4]))
        structure = next(sample_structures(height, width, rng, open_walls=open_walls))
        start, goal = rng.choice(structure.cells, size=2, replace=False).tolist()
        try:
            found.append(place(structure, start, goal, task, rng))
        except LabyrinthError:
            continue
        if len(found) == count:
            return found
    raise AssertionError(f"only {len(found)} structures of {1000 * count} hold {task}")


def number_of(labyrinth, situation):
    (row, column), has_key, door_open = situation
    cell = row * labyrinth.structure.width + column
    return state_index(labyrinth, State(cell, has_key, door_open))


def assert_optimal_in_every_state(labyrinth):
    """Assert that distances and optimal actions are those of brute force."""
    world = world_of(labyrinth)
    moves, best = moves_to_go(world), best_actions(world)
    found, optimal = distances(labyrinth), optimal_actions(labyrinth)
    assert distances(labyrinth, transition_table(labyrinth)) == found
    assert len(found) == state_count(labyrinth)
    assert optimal.shape == (state_count(labyrinth), 4)
    for situation in situations(world):
        number = number_of(labyrinth, situation)
        assert found[number] == moves.get(situation, UNREACHABLE)
        assert set(np.flatnonzero(optimal[number]).tolist()) == best[situation]


def assert_routes_of_brute_force(labyrinth):
    """Assert that every simple and every shortest route is found, and found once."""
    routes = brute_simple_routes(world_of(labyrinth))
    in_order = sorted(routes, key=lambda route: (len(route), route))
    assert list(map(tuple, simple_routes(labyrinth))) == in_order
    shortest = sorted(shortest_of(routes))
    assert list(map(tuple, shortest_routes(labyrinth))) == shortest
    assert tuple(shortest_route(labyrinth, np.random.default_rng(0))) in shortest


# Every structure of three by three, random labyrinths, and tiles wherever they may lie.


@pytest.mark.slow
def test_every_state_and_route_of_every_structure_of_three_by_three_is_found():
    everything = [each for each in all_structures(3, 3) if is_connected(3, 3, passages_of(each))]
    assert len(everything) == 431
    for structure in everything:
        labyrinth = Labyrinth(structure, 0, 8)
        assert_optimal_in_every_state(labyrinth)
        assert_routes_of_brute_force(labyrinth)


@pytest.mark.slow
@pytest.mark.parametrize("task", list(Task))
def test_every_route_of_random_labyrinths_is_found_once(task):
    for labyrinth in sampled(task, 250, 2, [(2, 2), (2, 5), (3, 3), (4, 3), (3, 4)]):
        assert_routes_of_brute_force(labyrinth)


@pytest.mark.slow
@pytest.mark.parametrize("task", list(Task))
def test_every_state_of_larger_labyrinths_is_solved_optimally(task):
    for labyrinth in sampled(task, 300, 1, [(4, 4), (5, 5), (6, 3), (6, 6)]):
        assert_optimal_in_every_state(labyrinth)


@given(labyrinths())
def test_every_state_is_solved_optimally_wherever_the_tiles_lie(labyrinth):
    assert_optimal_in_every_state(labyrinth)


@given(labyrinths())
def test_every_shortest_route_is_found_once_wherever_the_tiles_lie(labyrinth):
    world = world_of(labyrinth)
    best = best_actions(world)

    def onward(situation):
        if situation[0] == world.goal:
            return [[]]
        return [
            [action, *rest]
            for action in sorted(best[situation])
            for rest in onward(step(world, situation, action)[0])
        ]

    routes = onward((world.start, False, False))
    assert shortest_routes(labyrinth) == routes
    assert moves_and_routes(labyrinth) == (len(routes[0]), len(routes))


@given(labyrinths(Task.KEY_AND_DOOR))
def test_nothing_leads_on_from_a_door_that_the_agent_cannot_stand_in(labyrinth):
    closed = [labyrinth.door, labyrinth.door + labyrinth.structure.cells]
    assert [distances(labyrinth)[state] for state in closed] == [UNREACHABLE] * 2
    assert not optimal_actions(labyrinth)[closed].any()


# One shortest route of several.


# Chosen step by step, two of the six would come up every fourth time.
WITHOUT_WALLS = """
-------------
|         E |
|   +   +   |
|           |
|   +   +   |
| S         |
-------------
"""
ONE_BRANCH_HIDES_MORE = """
-----------------
|             E |
|   + - + - +   |
|   |           |
|   +   +   +   |
|   |           |
|   +   +   +   |
| S             |
-----------------
"""
A_KEY_TO_FETCH = """
-----------------
| K         | E |
|   +   +   +   |
|           | D |
|   +   +   +   |
| S             |
-----------------
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("drawing", "count"), [(WITHOUT_WALLS, 6), (ONE_BRANCH_HIDES_MORE, 7), (A_KEY_TO_FETCH, 6)]
)
def test_every_shortest_route_is_equally_likely(drawing, count):
    world = drawn(drawing)
    labyrinth = labyrinth_of(world, Task.KEY_AND_DOOR if world.door else Task.NAVIGATION)
    routes = list(map(tuple, shortest_routes(labyrinth)))
    draws = [
        tuple(shortest_route(labyrinth, np.random.default_rng(seed))) for seed in range(500 * count)
    ]
    counts = Counter(draws)
    assert len(routes) == count
    assert set(counts) == set(routes)
    assert chi_square([counts[route] for route in routes], [500.0] * count) < 5


def test_a_count_of_routes_beyond_any_machine_word_is_no_obstacle():
    labyrinth = without_walls(50, 50)
    route = shortest_route(labyrinth, np.random.default_rng(5))
    assert len(route) == 98
    assert replay(labyrinth, route).terminated


@given(labyrinths(), seeds)
def test_the_same_seed_gives_the_same_route(labyrinth, seed):
    first, second = (shortest_route(labyrinth, np.random.default_rng(seed)) for _ in "ab")
    assert first == second


# Limits.


@given(labyrinths(Task.NAVIGATION, Task.KEY_AND_DOOR), st.integers(0, 6))
def test_a_limit_cuts_the_shortest_routes_in_order(labyrinth, limit):
    assert shortest_routes(labyrinth, limit) == shortest_routes(labyrinth)[:limit]


def test_a_limit_gives_so_many_of_the_simple_routes_shortest_first():
    labyrinth = without_walls(4, 4)
    routes = set(map(tuple, simple_routes(labyrinth)))
    assert len(routes) == 184
    for limit in (0, 1, 7, 183, 184, 500):
        some = list(map(tuple, simple_routes(labyrinth, limit)))
        assert len(set(some)) == len(some) == min(limit, 184)
        assert set(some) <= routes
        assert some == sorted(some, key=lambda route: (len(route), route))


def test_a_limit_stops_the_search_where_there_are_more_routes_than_anyone_could_list():
    labyrinth = without_walls(12, 12)
    assert len(shortest_routes(labyrinth, 10)) == 10
    assert len(simple_routes(labyrinth, 10)) == 10


def lines_run(function):
    """Return how many lines of Python a function runs, which is the same on every machine."""
    lines = 0

    def trace(_frame, event, _argument):
        nonlocal lines
        lines += event == "line"
        return trace

    before = sys.gettrace()
    sys.settrace(trace)
    try:
        function()
    finally:
        sys.settrace(before)
    return lines


@pytest.mark.parametrize("task", [Task.NAVIGATION, Task.KEY_AND_DOOR])
def test_the_work_for_two_routes_is_a_few_walks_through_the_labyrinth(task):
    (labyrinth,) = sampled(task, 1, 7, [(40, 40)])
    table = transition_table(labyrinth)
    assert lines_run(lambda: simple_routes(labyrinth, 2)) < 60 * len(table)

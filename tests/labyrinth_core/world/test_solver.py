"""Optimal behaviour, against brute force over every situation of the rules."""

import sys
from collections import Counter
from itertools import groupby

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.brute_force import (
    WAYS,
    best_actions,
    chi_square,
    drawn,
    labyrinth_of,
    moves_to_go,
    situations,
    step,
    world_of,
)
from support.brute_force import simple_routes as brute_simple_routes
from support.strategies import labyrinths, structures

from labyrinth_core.world import (
    Episode,
    Labyrinth,
    RouteMemory,
    Solver,
    State,
    Structure,
    Task,
    sample_labyrinth,
)


def without_walls(height, width):
    return Labyrinth(Structure.without_walls(height, width), 0, height * width - 1)


@given(labyrinths())
def test_every_state_is_solved_optimally_wherever_the_tiles_lie(labyrinth):
    world = world_of(labyrinth)
    moves, best = moves_to_go(world), best_actions(world)
    found, optimal = Solver(labyrinth).distances, Solver(labyrinth).optimal_actions()
    assert len(found) == labyrinth.state_count
    assert optimal.shape == (labyrinth.state_count, 4)
    for situation in situations(world):
        (row, column), has_key, door_open = situation
        number = labyrinth.state_index(State(row * world.width + column, has_key, door_open))
        assert found[number] == moves.get(situation, -1)
        assert set(np.flatnonzero(optimal[number]).tolist()) == best[situation]
    if labyrinth.door is not None:  # The agent cannot stand in it while it is closed.
        closed = [labyrinth.door, labyrinth.door + labyrinth.structure.cells]
        assert [found[number] for number in closed] == [-1, -1]
        assert not optimal[closed].any()


@given(labyrinths().filter(lambda labyrinth: labyrinth.structure.cells <= 12))
def test_every_simple_route_is_found_once_the_shortest_first_wherever_the_tiles_lie(labyrinth):
    routes = brute_simple_routes(world_of(labyrinth))
    in_order = sorted(routes, key=lambda route: (len(route), route))
    assert list(map(tuple, Solver(labyrinth).simple_routes())) == in_order


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
    assert Solver(labyrinth).shortest_routes() == routes
    assert Solver(labyrinth).shortest_route(np.random.default_rng(0)) in routes
    assert Solver(labyrinth).moves_and_routes() == (len(routes[0]), len(routes))


# One shortest route of several.


# Chosen step by step, the route up the left column would come up every second time.
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
@pytest.mark.parametrize(("drawing", "count"), [(ONE_BRANCH_HIDES_MORE, 7), (A_KEY_TO_FETCH, 6)])
def test_every_shortest_route_is_equally_likely(drawing, count):
    world = drawn(drawing)
    labyrinth = labyrinth_of(world, Task.KEY_AND_DOOR if world.door else Task.NAVIGATION)
    routes = list(map(tuple, Solver(labyrinth).shortest_routes()))
    draws = [
        tuple(Solver(labyrinth).shortest_route(np.random.default_rng(seed)))
        for seed in range(500 * count)
    ]
    counts = Counter(draws)
    assert len(routes) == count
    assert set(counts) == set(routes)
    assert chi_square([counts[route] for route in routes], [500.0] * count) < 5


def test_a_count_of_routes_beyond_any_machine_word_is_no_obstacle():
    labyrinth = without_walls(50, 50)
    route = Solver(labyrinth).shortest_route(np.random.default_rng(5))
    assert len(route) == 98
    assert labyrinth.replay(route).terminated


# Limits.


@given(labyrinths(Task.NAVIGATION, Task.KEY_AND_DOOR), st.integers(0, 6))
def test_a_limit_cuts_the_shortest_routes_in_order(labyrinth, limit):
    assert Solver(labyrinth).shortest_routes(limit) == Solver(labyrinth).shortest_routes()[:limit]


def test_a_limit_gives_so_many_of_the_simple_routes_shortest_first():
    labyrinth = without_walls(4, 4)
    routes = set(map(tuple, Solver(labyrinth).simple_routes()))
    assert len(routes) == 184
    for limit in (0, 1, 7, 183, 184, 500):
        some = list(map(tuple, Solver(labyrinth).simple_routes(limit)))
        assert len(set(some)) == len(some) == min(limit, 184)
        assert set(some) <= routes
        assert some == sorted(some, key=lambda route: (len(route), route))


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
    labyrinth = sample_labyrinth(40, 40, task, np.random.default_rng(0), open_walls=0)
    table = labyrinth.transition_table()
    assert lines_run(lambda: Solver(labyrinth).simple_routes(2)) < 60 * len(table)


@pytest.mark.parametrize("routes", [Solver.simple_routes, Solver.shortest_routes])
def test_no_more_routes_are_looked_for_than_the_limit_says(routes):
    labyrinth = without_walls(5, 5)
    few, many = (lines_run(lambda n=n: routes(Solver(labyrinth), n)) for n in (2, 40))
    assert few < many / 3


def test_a_limit_of_routes_or_steps_is_a_whole_number():
    labyrinth = Labyrinth(Structure.without_walls(2, 2), 0, 3)
    assert Solver(labyrinth).shortest_routes(np.int64(1)) == Solver(labyrinth).simple_routes(1)
    for wrong in (True, 1.5, -1):
        refused = f"{wrong!r}: give a whole number from 0 on$"
        for routes in (Solver.shortest_routes, Solver.simple_routes):
            with pytest.raises(ValueError, match=f"^limit={refused}"):
                routes(Solver(labyrinth), wrong)
        with pytest.raises(ValueError, match=f"^max_steps={refused}"):
            Episode.random(labyrinth, np.random.default_rng(0), wrong)


@given(structures(), st.data())
def test_the_least_moves_between_two_cells_are_those_that_a_search_finds(structure, data):
    cells = st.integers(0, structure.cells - 1)
    source, target = data.draw(cells), data.draw(cells)
    assert structure.least_moves(source, target) == structure.distances(source)[target]


# Remembered routes.


def leads_to_the_goal(world, cells):
    """Return whether an agent on the start can visit these cells, the last of them the goal."""
    situation = (world.start, False, False)
    for cell in cells[1:]:
        reached = {step(world, situation, action)[0] for action in WAYS}
        place = divmod(cell, world.width)
        situation = next((each for each in reached if each[0] == place), None)
        if situation is None or place in world.ice:
            return False
    return divmod(cells[0], world.width) == world.start and situation[0] == world.goal


@given(labyrinth=labyrinths(), data=st.data())
def test_the_best_way_is_the_shortest_part_of_a_route_that_is_open(labyrinth, data):
    moves, world = labyrinth.structure.moves, world_of(labyrinth)
    cells = st.just(labyrinth.start) | st.integers(0, len(moves) - 1)
    walks = st.lists(st.integers(0, 3), max_size=16)
    routes = []
    for begin, actions in data.draw(st.lists(st.tuples(cells, walks), max_size=6)):
        route = [begin]
        for action in actions:  # Steps into walls are among them.
            route.append(moves[route[-1]][action])
        routes.append(route)
    plain = Labyrinth(labyrinth.structure, labyrinth.start, labyrinth.goal)
    for known in (plain, labyrinth):  # Also routes over ice, and to a door without its key.
        some = Solver(known).shortest_routes(data.draw(st.sampled_from([0, 1, 5])))
        routes += [[state.agent for state in known.replay(route).states] for route in some]
    ways = []
    for route in routes:
        visited = [cell for cell, _ in groupby(route)]
        for first in range(len(visited)):
            parts = [visited[first : last + 1] for last in range(first, len(visited))]
            ways += [len(part) - 1 for part in parts if leads_to_the_goal(world, part)]
    best = RouteMemory(routes).best(labyrinth)
    assert (None if best is None else len(best)) == min(ways, default=None)
    if best is not None:
        assert labyrinth.replay(best).states[-1].agent == labyrinth.goal


def test_ice_bars_a_route():
    room = Structure.without_walls(2, 2)
    labyrinth = Labyrinth(room, 0, 3, Task.ICY_FLOOR, ice=frozenset({1}))
    assert RouteMemory([[0, 1, 3]]).best(labyrinth) is None
    assert RouteMemory([[0, 1, 3], [0, 2, 3]]).best(labyrinth) == [0, 1]

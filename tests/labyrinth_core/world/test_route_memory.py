"""A memory of routes: what is open of them, and nothing but parts of them."""

from __future__ import annotations

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st
from strategies import connected_structures

from labyrinth_core.language.text import parse
from labyrinth_core.world.labyrinth import Labyrinth
from labyrinth_core.world.rollout import replay
from labyrinth_core.world.route_memory import RouteMemory

OPEN = """
labyrinth:
-------------
|         E |
|   +   +   |
|           |
|   +   +   |
| S         |
-------------
end
"""
"""Cells are numbered from 0 at the bottom left to 8 at the top right."""

UP_THEN_RIGHT, RIGHT_THEN_UP, ROUND = [0, 3, 6, 7, 8], [0, 1, 2, 5, 8], [0, 1, 4, 3, 6, 7, 8]


def open_ways(labyrinth: Labyrinth, routes: list[list[int]]) -> list[int]:
    """Return how long the parts of routes are that lead from start to goal through passages."""
    found = []
    for route in routes:
        cells = [cell for place, cell in enumerate(route) if place == 0 or route[place - 1] != cell]
        for first, cell in enumerate(cells):
            for last in range(first, len(cells)):
                part = cells[first : last + 1]
                moves = labyrinth.structure.moves
                passable = all(after in moves[here] for here, after in pairwise(part))
                if cell == labyrinth.start and part[-1] == labyrinth.goal and passable:
                    found.append(last - first)
    return found


@given(structure=connected_structures(), data=st.data())
def test_the_best_way_is_the_shortest_part_of_a_route_that_is_open(structure, data):
    cells = st.integers(0, structure.cells - 1)
    start, goal = data.draw(st.lists(cells, min_size=2, max_size=2, unique=True))
    labyrinth = Labyrinth(structure, start, goal)
    walks = st.lists(st.integers(0, 3), max_size=12)
    routes = []
    for begin, actions in data.draw(st.lists(st.tuples(cells, walks), max_size=6)):
        route = [begin]
        for action in actions:  # Steps into walls are among them.
            route.append(structure.moves[route[-1]][action])
        routes.append(route)
    best, ways = RouteMemory(routes).best(labyrinth), open_ways(labyrinth, routes)
    assert (None if best is None else len(best)) == min(ways, default=None)
    if best is not None:
        assert replay(labyrinth, best).states[-1].agent == goal


@pytest.mark.parametrize(
    ("routes", "expected"),
    [
        ([], None),
        ([UP_THEN_RIGHT], [0, 0, 1, 1]),
        ([ROUND], [1, 0, 3, 0, 1, 1]),
        ([ROUND, RIGHT_THEN_UP], [1, 1, 0, 0]),
        ([UP_THEN_RIGHT[1:]], None),
        ([[2, 1, 0, 0, 3, 6, 7, 8, 5]], [0, 0, 1, 1]),
    ],
)
def test_routes_are_found_again_and_the_shortest_is_taken(routes, expected):
    assert RouteMemory(routes).best(parse(OPEN)) == expected


def test_a_wall_or_ice_bars_a_route():
    walled = OPEN.replace("|   +   +   |\n| S ", "| - +   +   |\n| S ")
    iced = "icy_floor: True\n" + OPEN.replace("| S         |", "| S       I |")
    assert RouteMemory([UP_THEN_RIGHT]).best(parse(walled)) is None
    assert RouteMemory([UP_THEN_RIGHT, RIGHT_THEN_UP]).best(parse(walled)) == [1, 1, 0, 0]
    assert RouteMemory([RIGHT_THEN_UP]).best(parse(iced)) is None

"""A memory of routes: what is open of them, and nothing but parts of them."""

from itertools import groupby

from brute_force import WAYS, step, world_of
from hypothesis import given
from hypothesis import strategies as st
from strategies import labyrinths

from labyrinth_core.world.dynamics import replay
from labyrinth_core.world.labyrinth import Labyrinth, Structure, Task
from labyrinth_core.world.route_memory import RouteMemory
from labyrinth_core.world.solver import shortest_routes


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
        some = shortest_routes(known, data.draw(st.sampled_from([0, 1, 5])))
        routes += [[state.agent for state in replay(known, route).states] for route in some]
    ways = []
    for route in routes:
        visited = [cell for cell, _ in groupby(route)]
        for first in range(len(visited)):
            parts = [visited[first : last + 1] for last in range(first, len(visited))]
            ways += [len(part) - 1 for part in parts if leads_to_the_goal(world, part)]
    best = RouteMemory(routes).best(labyrinth)
    assert (None if best is None else len(best)) == min(ways, default=None)
    if best is not None:
        assert replay(labyrinth, best).states[-1].agent == labyrinth.goal


def test_ice_bars_a_route():
    room = Structure.without_walls(2, 2)
    labyrinth = Labyrinth(room, 0, 3, Task.ICY_FLOOR, ice=frozenset({1}))
    assert RouteMemory([[0, 1, 3]]).best(labyrinth) is None
    assert RouteMemory([[0, 1, 3], [0, 2, 3]]).best(labyrinth) == [0, 1]

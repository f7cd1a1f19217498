"""The original's mistakes, by their numbers in the project's list of facts: none is made here.

Those of the environment (2, 3, 7) and of the pipeline (8 to 11) are tested with them.
"""

import numpy as np
import pytest
from brute_force import (
    all_structures,
    drawn,
    is_connected,
    labyrinth_of,
    moves_to_go,
    passages_of,
    simple_routes,
    world_of,
)

from labyrinth_core.world.dynamics import State, initial, is_terminal, reward, transition
from labyrinth_core.world.grid import Action
from labyrinth_core.world.labyrinth import Labyrinth, LabyrinthError, Task
from labyrinth_core.world.rollout import replay
from labyrinth_core.world.sampling import sample_structure
from labyrinth_core.world.solver import shortest_route, shortest_routes
from labyrinth_core.world.tasks import change_start, change_start_and_goal, place


def icy(count, size, seed):
    """Return sampled labyrinths with ice between the default start and goal."""
    rng, found = np.random.default_rng(seed), []
    for _ in range(1000 * count):
        structure = sample_structure(size, size, rng)
        try:
            found.append(place(structure, 0, size * size - 1, Task.ICY_FLOOR, rng))
        except LabyrinthError:
            continue
        if len(found) == count:
            return found
    raise AssertionError(f"only {len(found)} structures of {1000 * count} hold ice")


def fewest_moves(world):
    return moves_to_go(world).get((world.start, False, False))


# 1: the first route that a depth-first search meets was taken for the shortest.


def first_met(world):
    """Return the cells of the first route that a depth-first search meets, actions in order."""
    stack = [(world.start,)]
    while stack[-1][-1] != world.goal:
        route = stack.pop()
        row, column = route[-1]
        ahead = [(row + 1, column), (row, column + 1), (row - 1, column), (row, column - 1)]
        stack += [
            (*route, place)
            for place in reversed(ahead)
            if place not in route and frozenset({route[-1], place}) in world.passages
        ]
    return stack[-1]


def test_1_the_shortest_route_is_the_shortest_also_where_a_depth_first_search_meets_another():
    misled = 0
    for structure in all_structures(3, 3):
        if is_connected(3, 3, passages_of(structure)):
            labyrinth = Labyrinth(structure, 0, 8)
            world = world_of(labyrinth)
            least = min(map(len, simple_routes(world)))
            assert len(shortest_route(labyrinth, np.random.default_rng(0))) == least
            assert {len(route) for route in shortest_routes(labyrinth)} == {least}
            misled += len(first_met(world)) - 1 > least
    assert misled > 20


# A bump into a wall with ice behind it ended the episode (facts, section 1).


def test_a_bump_into_a_wall_with_ice_behind_it_does_not_end_the_episode():
    for labyrinth in icy(30, 5, seed=1):
        moves = labyrinth.structure.moves
        for cell in set(range(25)) - labyrinth.ice - {labyrinth.goal}:
            for action in Action:
                after = transition(labyrinth, State(cell), action)
                if moves[cell][action] == cell:
                    assert after == State(cell)
                    assert reward(labyrinth, after) == pytest.approx(-0.1 / 25)
                    assert not is_terminal(labyrinth, after)


# 3, the part that concerns the core: a key stayed picked up, old ice stayed when tiles moved.


def test_3_another_start_never_leaves_ice_without_a_way_through():
    rng = np.random.default_rng(2)
    for labyrinth in icy(100, 5, seed=3):
        for change in (change_start, change_start_and_goal):
            try:
                changed = world_of(change(labyrinth, rng))
            except LabyrinthError:
                continue
            assert fewest_moves(changed) > fewest_moves(changed.without("ice"))


# 4: ice changed nothing in most labyrinths.


@pytest.mark.parametrize("size", [3, 4, 5, 6])
def test_4_ice_always_makes_the_shortest_route_longer(size):
    for labyrinth in icy(150, size, seed=size):
        world = world_of(labyrinth)
        with_ice = len(shortest_route(labyrinth, np.random.default_rng(0)))
        assert with_ice == fewest_moves(world) > fewest_moves(world.without("ice"))


# 5: a goal that was not the last cell lost its passages, and rectangles crashed.


def test_5_a_goal_anywhere_keeps_its_passages():
    world = drawn(
        """
        -------------
        |           |
        |   + - +   |
        |     E |   |
        | - +   +   |
        | S         |
        -------------
        """
    )
    labyrinth = labyrinth_of(world)
    assert passages_of(labyrinth.structure) == world.passages
    assert labyrinth.structure.moves[4] == (4, 4, 1, 3)
    assert shortest_routes(labyrinth) == [[1, 0]]
    assert sorted(simple_routes(world)) == [(1, 0), (1, 1, 0, 0, 3, 3, 2, 1)]


def test_5_every_cell_can_be_the_goal_of_every_start():
    structure = sample_structure(4, 4, np.random.default_rng(4))
    for start in range(16):
        for goal in set(range(16)) - {start}:
            labyrinth = Labyrinth(structure, start, goal)
            episode = replay(labyrinth, shortest_route(labyrinth, np.random.default_rng(0)))
            assert episode.states[-1].agent == goal
            assert len(episode) == fewest_moves(world_of(labyrinth))


@pytest.mark.parametrize(("height", "width"), [(2, 5), (5, 2), (3, 7), (7, 3), (2, 12)])
@pytest.mark.parametrize("task", list(Task))
def test_5_rectangles_are_sampled_placed_solved_and_replayed(height, width, task):
    rng, solved = np.random.default_rng(5), 0
    for _ in range(400):
        structure = sample_structure(height, width, rng, open_walls=0.2)
        start, goal = rng.choice(height * width, size=2, replace=False).tolist()
        try:
            labyrinth = place(structure, start, goal, task, rng)
        except LabyrinthError:
            continue
        episode = replay(labyrinth, shortest_route(labyrinth, rng))
        assert episode.states[0] == initial(labyrinth) == State(start)
        assert episode.states[-1].agent == goal
        assert len(episode) == fewest_moves(world_of(labyrinth))
        solved += 1
    assert solved >= 10


# 6: another start and goal could be the ones there were.


@pytest.mark.parametrize(("height", "width"), [(2, 2), (2, 3), (3, 3), (5, 5)])
def test_6_another_start_and_goal_are_never_those_there_were(height, width):
    rng = np.random.default_rng(6)
    for _ in range(200):
        structure = sample_structure(height, width, rng)
        start, goal = rng.choice(structure.cells, size=2, replace=False).tolist()
        labyrinth = Labyrinth(structure, start, goal)
        moved = change_start(labyrinth, rng)
        assert moved.start != start
        assert moved.goal == goal
        both = change_start_and_goal(labyrinth, rng)
        assert (both.start, both.goal) != (start, goal)
        assert both.start != start
        assert both.goal != goal

"""Where start, goal, key, door and ice lie: the heuristics, against their rules by brute force."""

from collections import Counter
from dataclasses import replace
from itertools import combinations, permutations

import numpy as np
import pytest
from brute_force import (
    World,
    all_structures,
    chi_square,
    drawn,
    fewest_moves,
    is_connected,
    keeps_the_rules,
    labyrinth_of,
    passages_of,
    reachable,
    unavoidable,
    world_of,
)
from hypothesis import given
from hypothesis import strategies as st
from strategies import connected_structures, labyrinths

from labyrinth_core.world.labyrinth import Labyrinth, LabyrinthError, Structure, Task
from labyrinth_core.world.random_labyrinth import (
    change_start,
    change_start_and_goal,
    draw_start_and_goal,
)
from labyrinth_core.world.sampling import sample_structures
from labyrinth_core.world.tasks import place, tiles_matter

seeds = st.integers(0, 2**32 - 1)


def world_between(structure, start, goal):
    """Return the world without tiles, also where no route leads from start to goal."""
    height, width = structure.height, structure.width
    return World(height, width, passages_of(structure), divmod(start, width), divmod(goal, width))


def on_shortest_routes(world):
    least = fewest_moves(world)
    return {
        place
        for place in reachable(world.passages, world.start) - {world.start, world.goal}
        if fewest_moves(replace(world, goal=place)) + fewest_moves(replace(world, start=place))
        == least
    }


def keys_and_doors(world):
    """Return every pair of cells that the rules allow: fetching the key has to be a detour."""
    doors = unavoidable(world)
    passed_by = on_shortest_routes(world)
    return {
        (row * world.width + column, door_row * world.width + door_column)
        for door_row, door_column in doors
        for row, column in reachable(world.passages, world.start, [(door_row, door_column)])
        if (row, column) not in passed_by | {world.start}
    }


def ice_can_matter(world):
    """Return whether any ice on shortest routes leaves a route, and only longer ones."""
    least, candidates = fewest_moves(world), sorted(on_shortest_routes(world))
    return any(
        (fewest_moves(replace(world, ice=frozenset(ice))) or 0) > least
        for count in range(1, len(candidates) + 1)
        for ice in combinations(candidates, count)
    )


def cell(world, letter):
    row, column = getattr(world, letter)
    return row * world.width + column


def made_or_reason(make, *arguments):
    """Return the labyrinth, or the message that says why there is none."""
    try:
        return make(*arguments)
    except LabyrinthError as error:
        return str(error)


@st.composite
def ends(draw, among=connected_structures):
    """A structure, a start and a goal."""
    structure = draw(among())
    cells = st.integers(0, structure.cells - 1)
    return structure, *draw(st.lists(cells, min_size=2, max_size=2, unique=True))


# Placing.


@given(ends(), st.sampled_from([Task.NAVIGATION, Task.PARTIAL_OBSERVABILITY]))
def test_tasks_without_tiles_need_nothing_placed(where, task):
    labyrinth = place(*where, task, np.random.default_rng(0))
    assert labyrinth == Labyrinth(*where, task)
    assert tiles_matter(labyrinth)


@given(ends(), seeds)
def test_key_and_door_are_placed_by_the_rules_wherever_they_allow_it(where, seed):
    allowed = keys_and_doors(world_between(*where))
    if not allowed:
        with pytest.raises(LabyrinthError, match=r"^no place for the (key|door): no"):
            place(*where, Task.KEY_AND_DOOR, np.random.default_rng(seed))
        return
    labyrinth = place(*where, Task.KEY_AND_DOOR, np.random.default_rng(seed))
    assert (labyrinth.structure, labyrinth.start, labyrinth.goal) == where
    assert (labyrinth.key, labyrinth.door) in allowed
    assert keeps_the_rules(world_of(labyrinth), Task.KEY_AND_DOOR)
    assert tiles_matter(labyrinth)


@pytest.mark.slow
@pytest.mark.parametrize("tile", ["key", "door"])
@given(ends(), seeds, st.data())
def test_a_tile_that_is_given_stays_and_gets_the_other_if_one_fits(tile, where, seed, data):
    given_cell = data.draw(st.integers(0, where[0].cells - 1))
    pairs = [{"key": key, "door": door} for key, door in keys_and_doors(world_between(*where))]
    allowed = [pair for pair in pairs if pair[tile] == given_cell]
    rng, given_tile = np.random.default_rng(seed), {tile: given_cell}
    if allowed:
        labyrinth = place(*where, Task.KEY_AND_DOOR, rng, **given_tile)
        assert {"key": labyrinth.key, "door": labyrinth.door} in allowed
    else:
        with pytest.raises(LabyrinthError):
            place(*where, Task.KEY_AND_DOOR, rng, **given_tile)


@given(ends(), seeds)
def test_ice_lies_on_shortest_routes_and_leaves_none_but_longer_ones(where, seed):
    world = world_between(*where)
    labyrinth = made_or_reason(place, *where, Task.ICY_FLOOR, np.random.default_rng(seed))
    if isinstance(labyrinth, str):
        assert labyrinth.startswith("ice would not matter: no longer route avoids")
        return
    icy = world_of(labyrinth)
    assert replace(icy, ice=frozenset()) == world
    assert icy.ice <= on_shortest_routes(world)
    assert fewest_moves(icy) > fewest_moves(world)
    assert tiles_matter(labyrinth)


@pytest.mark.slow
def test_ice_is_placed_wherever_it_can_matter():
    """In every structure of three by three, and in some larger ones."""
    everything = [each for each in all_structures(3, 3) if is_connected(3, 3, passages_of(each))]
    places = [(structure, 0, 8) for structure in everything]
    rng = np.random.default_rng(21)
    for _ in range(60):
        height, width = rng.integers(3, 5, size=2).tolist()
        structure = next(sample_structures(height, width, rng, open_walls=0.4))
        start, goal = rng.choice(structure.cells, size=2, replace=False).tolist()
        places.append((structure, start, goal))
    for where in places:
        can = ice_can_matter(world_between(*where))
        for seed in range(5):
            rng = np.random.default_rng(seed)
            if can:
                place(*where, Task.ICY_FLOOR, rng)
            else:
                with pytest.raises(LabyrinthError, match=r"^ice would not matter"):
                    place(*where, Task.ICY_FLOOR, rng)


def test_every_place_for_key_and_door_comes_up():
    world = drawn(
        """
        -----------------
        |   |   |       |
        |   +   +   + - |
        |           | E |
        |   + - + - +   |
        | S             |
        -----------------
        """
    )
    structure = labyrinth_of(world).structure
    start, goal = cell(world, "start"), cell(world, "goal")
    allowed = keys_and_doors(world)
    placed = Counter()
    for seed in range(400):
        rng = np.random.default_rng(seed)
        labyrinth = place(structure, start, goal, Task.KEY_AND_DOOR, rng)
        placed[labyrinth.key, labyrinth.door] += 1
    assert len(allowed) > 10
    assert set(placed) == allowed


@pytest.mark.parametrize("task", list(Task))
@pytest.mark.parametrize("goal", [0, 9, 8])  # The start, outside, and where no route leads.
def test_an_end_that_cannot_be_is_named_before_anything_is_placed(task, goal):
    island = Structure(3, 3, 0b11, 0b1)
    with pytest.raises(LabyrinthError, match=r"share a cell|outside the grid|no route leads"):
        place(island, 0, goal, task, np.random.default_rng(0))


ROOM, CORRIDOR = Structure.without_walls(3, 3), Structure(2, 2, 0b10, 0b0101)


@pytest.mark.parametrize(
    ("structure", "goal", "task", "given_tiles", "message"),
    [
        (ROOM, 8, Task.KEY_AND_DOOR, {}, "no place for the door: no cell lies on every route"),
        (ROOM, 8, Task.ICY_FLOOR, {}, "ice would not matter: no longer route avoids"),
        (CORRIDOR, 2, Task.KEY_AND_DOOR, {}, "no place for the key: none is off the route"),
        (CORRIDOR, 2, Task.KEY_AND_DOOR, {"key": 1}, "no place for the door that fits the key"),
    ],
)
def test_where_tiles_cannot_be_placed_the_reason_is_given(
    structure, goal, task, given_tiles, message
):
    with pytest.raises(LabyrinthError, match=f"^{message}"):
        place(structure, 0, goal, task, np.random.default_rng(0), **given_tiles)


@given(labyrinths())
def test_tiles_matter_when_they_make_the_best_route_longer_than_it_would_be(labyrinth):
    world = world_of(labyrinth)
    plain = replace(world, key=None, door=None, ice=frozenset())
    matter = {
        Task.KEY_AND_DOOR: lambda: world.key not in on_shortest_routes(plain),
        Task.ICY_FLOOR: lambda: fewest_moves(world) > fewest_moves(plain),
    }.get(labyrinth.task, lambda: True)
    assert tiles_matter(labyrinth) == matter()


# Another start, another goal.


def apart(labyrinth, start, goal):
    (row, column), (other_row, other_column) = map(labyrinth.position, (start, goal))
    return abs(row - other_row) + abs(column - other_column)


@pytest.mark.parametrize("change", [change_start, change_start_and_goal])
@given(labyrinths(), seeds)
def test_a_changed_start_or_goal_is_another_one_far_enough_from_the_other(change, labyrinth, seed):
    structure = labyrinth.structure
    changed = made_or_reason(change, labyrinth, np.random.default_rng(seed))
    if isinstance(changed, str):
        assert changed == f"no other start or goal can hold {labyrinth.task}"
        assert labyrinth.task in (Task.KEY_AND_DOOR, Task.ICY_FLOOR)
        return
    assert (changed.structure, changed.task) == (structure, labyrinth.task)
    assert changed.start not in (labyrinth.start, changed.goal)
    assert (changed.goal == labyrinth.goal) == (change is change_start)
    far_enough = (structure.height + structure.width) // 2
    if change is change_start:
        others = set(range(structure.cells)) - {labyrinth.start}
        farthest = max(apart(labyrinth, start, labyrinth.goal) for start in others)
        far_enough = min(far_enough, farthest)
    assert apart(changed, changed.start, changed.goal) >= far_enough
    assert tiles_matter(changed)


@given(labyrinths(Task.KEY_AND_DOOR, Task.ICY_FLOOR), seeds)
def test_a_start_is_only_given_up_when_no_other_can_hold_the_task(labyrinth, seed):
    structure, goal = labyrinth.structure, labyrinth.goal
    others = [cell for cell in range(structure.cells) if cell not in (labyrinth.start, goal)]
    farthest = max(apart(labyrinth, start, goal) for start in others)
    far_enough = min((structure.height + structure.width) // 2, farthest)
    holds = False
    for start in others:
        if apart(labyrinth, start, goal) >= far_enough:
            try:
                place(structure, start, goal, labyrinth.task, np.random.default_rng(0))
            except LabyrinthError:
                continue
            holds = True
    if holds:
        change_start(labyrinth, np.random.default_rng(seed))
    else:
        with pytest.raises(LabyrinthError, match=r"^no other start or goal can hold"):
            change_start(labyrinth, np.random.default_rng(seed))


def test_on_two_by_two_cells_start_and_goal_change_to_any_other_corners():
    labyrinth = Labyrinth(Structure.without_walls(2, 2), 0, 3)
    pairs = {
        (changed.start, changed.goal)
        for seed in range(50)
        for changed in [change_start_and_goal(labyrinth, np.random.default_rng(seed))]
    }
    assert pairs == {(3, 0), (1, 2), (2, 1)}


def test_every_start_that_is_far_enough_is_equally_likely():
    labyrinth = Labyrinth(Structure.without_walls(4, 4), 0, 15)
    allowed = [start for start in range(1, 15) if apart(labyrinth, start, labyrinth.goal) >= 4]
    rng = np.random.default_rng(22)
    counts = Counter(change_start(labyrinth, rng).start for _ in range(100 * len(allowed)))
    assert set(counts) == set(allowed)
    assert chi_square(counts.values(), [100.0] * len(allowed)) < 5


@given(connected_structures(), st.sampled_from(list(Task)), seeds)
def test_a_drawn_start_and_goal_are_far_enough_apart_and_hold_the_task(structure, task, seed):
    far_enough = (structure.height + structure.width) // 2
    pairs = [
        pair
        for pair in permutations(range(structure.cells), 2)
        if apart(Labyrinth(structure, *pair), *pair) >= far_enough
    ]
    found = made_or_reason(draw_start_and_goal, structure, task, np.random.default_rng(seed))
    if isinstance(found, str):
        assert found == f"no start or goal can hold {task}"
        for start, goal in pairs:
            with pytest.raises(LabyrinthError):
                place(structure, start, goal, task, np.random.default_rng(seed))
        return
    assert (found.structure, found.task) == (structure, task)
    assert (found.start, found.goal) in pairs
    assert keeps_the_rules(world_of(found), task)
    assert tiles_matter(found)


def test_goals_are_drawn_equally_often_and_then_the_starts_that_are_far_enough():
    structure, rng = Structure.without_walls(3, 3), np.random.default_rng(5)
    labyrinth = Labyrinth(structure, 0, 8)
    ways = {goal: [s for s in range(9) if apart(labyrinth, s, goal) >= 3] for goal in range(9)}
    assert ways.pop(4) == []  # Nothing is far from the middle.
    expected = {(s, goal): 2000 / 8 / len(ways[goal]) for goal in ways for s in ways[goal]}
    found = (draw_start_and_goal(structure, Task.NAVIGATION, rng) for _ in range(2000))
    counts = Counter((each.start, each.goal) for each in found)
    assert set(counts) == set(expected)
    assert chi_square([counts[pair] for pair in expected], expected.values()) < 5

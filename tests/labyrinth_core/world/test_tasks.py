"""Where start, goal, key, door and ice lie: the heuristics, against their rules by brute force."""

import re
from collections import Counter
from dataclasses import replace
from itertools import combinations, permutations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.brute_force import (
    World,
    all_structures,
    chi_square,
    fewest_moves,
    is_connected,
    keeps_the_rules,
    passages_of,
    reachable,
    unavoidable,
    world_of,
)
from support.strategies import connected_structures, labyrinths

from labyrinth_core.world import (
    Labyrinth,
    LabyrinthError,
    Placer,
    Solver,
    Structure,
    Task,
    sample_labyrinth,
)

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


def made_or_reason(make, *arguments):
    """Return the labyrinth, or the message that says why there is none."""
    try:
        return make(*arguments)
    except LabyrinthError as error:
        return str(error)


@st.composite
def ends(draw):
    """A structure, a start and a goal."""
    structure = draw(connected_structures())
    cells = st.integers(0, structure.cells - 1)
    return structure, *draw(st.lists(cells, min_size=2, max_size=2, unique=True))


# Placing.


@given(ends(), st.sampled_from([Task.NAVIGATION, Task.PARTIAL_OBSERVABILITY]))
def test_tasks_without_tiles_need_nothing_placed(where, task):
    labyrinth = Placer(np.random.default_rng(0)).place(*where, task)
    assert labyrinth == Labyrinth(*where, task)
    assert Solver(labyrinth).tiles_matter


@given(ends(), seeds)
def test_key_and_door_are_placed_by_the_rules_wherever_they_allow_it(where, seed):
    allowed = keys_and_doors(world_between(*where))
    if not allowed:
        with pytest.raises(LabyrinthError, match=r"^no place for the (key|door): no"):
            Placer(np.random.default_rng(seed)).place(*where, Task.KEY_AND_DOOR)
        return
    labyrinth = Placer(np.random.default_rng(seed)).place(*where, Task.KEY_AND_DOOR)
    assert (labyrinth.structure, labyrinth.start, labyrinth.goal) == where
    assert (labyrinth.key, labyrinth.door) in allowed
    assert keeps_the_rules(world_of(labyrinth), Task.KEY_AND_DOOR)
    assert Solver(labyrinth).tiles_matter


@pytest.mark.slow
@pytest.mark.parametrize("tile", ["key", "door"])
@given(ends(), seeds, st.data())
def test_a_tile_that_is_given_stays_and_gets_the_other_if_one_fits(tile, where, seed, data):
    given_cell = data.draw(st.integers(0, where[0].cells - 1))
    pairs = [{"key": key, "door": door} for key, door in keys_and_doors(world_between(*where))]
    allowed = [pair for pair in pairs if pair[tile] == given_cell]
    rng, given_tile = np.random.default_rng(seed), {tile: given_cell}
    if allowed:
        labyrinth = Placer(rng).place(*where, Task.KEY_AND_DOOR, **given_tile)
        assert {"key": labyrinth.key, "door": labyrinth.door} in allowed
    else:
        with pytest.raises(LabyrinthError):
            Placer(rng).place(*where, Task.KEY_AND_DOOR, **given_tile)


@given(ends(), seeds)
def test_ice_lies_on_shortest_routes_and_leaves_none_but_longer_ones(where, seed):
    world = world_between(*where)
    labyrinth = made_or_reason(Placer(np.random.default_rng(seed)).place, *where, Task.ICY_FLOOR)
    if isinstance(labyrinth, str):
        assert labyrinth.startswith("no place for ice: blocking the shortest routes")
        return
    icy = world_of(labyrinth)
    assert replace(icy, ice=frozenset()) == world
    assert icy.ice <= on_shortest_routes(world)
    assert fewest_moves(icy) > fewest_moves(world)
    assert Solver(labyrinth).tiles_matter


@pytest.mark.slow
def test_ice_is_placed_wherever_it_can_matter():
    """In every structure of three by three, and in some larger ones."""
    everything = [each for each in all_structures(3, 3) if is_connected(3, 3, passages_of(each))]
    places = [(structure, 0, 8) for structure in everything]
    rng = np.random.default_rng(21)
    for _ in range(60):
        height, width = rng.integers(3, 5, size=2).tolist()
        structure = next(Structure.sample(height, width, rng, open_walls=0.4))
        start, goal = rng.choice(structure.cells, size=2, replace=False).tolist()
        places.append((structure, start, goal))
    for where in places:
        can = ice_can_matter(world_between(*where))
        for seed in range(5):
            rng = np.random.default_rng(seed)
            if can:
                Placer(rng).place(*where, Task.ICY_FLOOR)
            else:
                with pytest.raises(LabyrinthError, match=r"^no place for ice"):
                    Placer(rng).place(*where, Task.ICY_FLOOR)


def test_every_place_for_key_and_door_comes_up():
    structure = next(Structure.sample(4, 4, np.random.default_rng(1)))
    allowed = keys_and_doors(world_between(structure, 0, 15))
    placed = Counter()
    for seed in range(400):
        rng = np.random.default_rng(seed)
        labyrinth = Placer(rng).place(structure, 0, 15, Task.KEY_AND_DOOR)
        placed[labyrinth.key, labyrinth.door] += 1
    assert len(allowed) > 10
    assert set(placed) == allowed


@pytest.mark.parametrize("task", list(Task))
@pytest.mark.parametrize("goal", [0, 9, 8])  # The start, outside, and where no route leads.
def test_an_end_that_cannot_be_is_named_before_anything_is_placed(task, goal):
    island = Structure(3, 3, 0b11, 0b1)
    with pytest.raises(LabyrinthError, match=r"share a cell|outside the grid|no route leads"):
        Placer(np.random.default_rng(0)).place(island, 0, goal, task)


ROOM, CORRIDOR = Structure.without_walls(3, 3), Structure(2, 2, 0b10, 0b0101)


@pytest.mark.parametrize(
    ("structure", "goal", "task", "given_tiles", "message"),
    [
        (ROOM, 8, Task.KEY_AND_DOOR, {}, "no place for the door: no cell lies on every route"),
        (ROOM, 8, Task.ICY_FLOOR, {}, "no place for ice: blocking the shortest routes"),
        (CORRIDOR, 2, Task.KEY_AND_DOOR, {}, "no place for the key: no cell before the door"),
        (CORRIDOR, 2, Task.KEY_AND_DOOR, {"key": 1}, "no place for the door that fits the key"),
    ],
)
def test_where_tiles_cannot_be_placed_the_reason_is_given(
    structure, goal, task, given_tiles, message
):
    with pytest.raises(LabyrinthError, match=f"^{message}"):
        Placer(np.random.default_rng(0)).place(structure, 0, goal, task, **given_tiles)


@given(labyrinths())
def test_tiles_matter_when_they_make_the_best_route_longer_than_it_would_be(labyrinth):
    world = world_of(labyrinth)
    plain = World(world.height, world.width, world.passages, world.start, world.goal)
    if labyrinth.task is Task.KEY_AND_DOOR:
        matter = world.key not in on_shortest_routes(plain)
    elif labyrinth.task.rules.tiles:
        matter = fewest_moves(world) > fewest_moves(plain)
    else:
        matter = True
    assert Solver(labyrinth).tiles_matter == matter


# Another start, another goal.


def apart(labyrinth, start, goal):
    (row, column), (other_row, other_column) = map(labyrinth.position, (start, goal))
    return abs(row - other_row) + abs(column - other_column)


def change_start(labyrinth, rng):
    return Placer(rng).other_start(labyrinth)


def change_goal(labyrinth, rng):
    return Placer(rng).other_goal(labyrinth)


def change_start_and_goal(labyrinth, rng):
    return Placer(rng).other_ends(labyrinth)


def draw_anew(labyrinth, rng):
    return Placer(rng).any_ends(labyrinth.structure, labyrinth.task)


def far_enough(labyrinth, change):
    """Return the starts and goals that a change may give, far enough apart."""
    pairs = [
        (start, goal)
        for start, goal in permutations(range(labyrinth.structure.cells), 2)
        if change is draw_anew
        or (
            (start != labyrinth.start) == (change is not change_goal)
            and (goal != labyrinth.goal) == (change is not change_start)
        )
    ]
    least = (labyrinth.structure.height + labyrinth.structure.width) // 2
    if change in (change_start, change_goal):
        least = min(least, max(apart(labyrinth, *pair) for pair in pairs))
    return [pair for pair in pairs if apart(labyrinth, *pair) >= least]


@pytest.mark.parametrize("change", [change_start, change_goal, change_start_and_goal, draw_anew])
@given(labyrinths(), seeds)
def test_start_and_goal_change_to_cells_far_enough_apart_unless_none_hold_the_task(
    change, labyrinth, seed
):
    structure, task, pairs = labyrinth.structure, labyrinth.task, far_enough(labyrinth, change)
    changed = made_or_reason(change, labyrinth, np.random.default_rng(seed))
    if isinstance(changed, str):
        assert re.fullmatch(rf"no (other )?(start or )?goal can hold {task}", changed)
        for pair in pairs:
            with pytest.raises(LabyrinthError):
                Placer(np.random.default_rng(seed)).place(structure, *pair, task)
        return
    assert (changed.structure, changed.task) == (structure, task)
    assert (changed.start, changed.goal) in pairs
    assert keeps_the_rules(world_of(changed), task)
    assert Solver(changed).tiles_matter


def test_goals_are_drawn_equally_often_and_then_the_starts_that_are_far_enough():
    structure, rng = Structure.without_walls(3, 3), np.random.default_rng(5)
    labyrinth = Labyrinth(structure, 0, 8)
    ways = {goal: [s for s in range(9) if apart(labyrinth, s, goal) >= 3] for goal in range(9)}
    assert ways.pop(4) == []  # Nothing is far from the middle.
    expected = {(s, goal): 2000 / 8 / len(ways[goal]) for goal in ways for s in ways[goal]}
    found = (Placer(rng).any_ends(structure, Task.NAVIGATION) for _ in range(2000))
    counts = Counter((each.start, each.goal) for each in found)
    assert set(counts) == set(expected)
    assert chi_square([counts[pair] for pair in expected], expected.values()) < 5


def test_the_numbers_of_a_random_labyrinth_may_be_numpys_and_are_looked_at_first():
    def sample(height, width, **ends):
        return sample_labyrinth(height, width, Task.NAVIGATION, np.random.default_rng(0), **ends)

    sides = np.uint8(20), np.int64(20)
    assert sample(*sides, start=np.int64(70), goal=np.int16(399)) == sample(20, 20, start=70)
    for arguments, message in [
        ({"height": 10**6, "width": 5}, "height=1000000: give a whole number from 2 to 1000"),
        ({"height": 5, "width": 5.0}, "width=5.0: give a whole number from 2 to 1000"),
        ({"height": 5, "width": 5, "start": 25}, "start=25: give a whole number from 0 to 24"),
        ({"height": 5, "width": 5, "goal": True}, "goal=True: give a whole number from 0 to 24"),
    ]:
        with pytest.raises(ValueError, match=f"^{message}$"):
            sample(**arguments)


def test_an_unknown_task_is_refused_at_once_with_the_known_ones() -> None:
    with pytest.raises(ValueError, match=r"\Atask=keys: choose one of navigation, partial_obs"):
        sample_labyrinth(3, 3, "keys", np.random.default_rng(0))  # type: ignore[arg-type]

"""Structures and labyrinths: identity, symmetries, and the rules each labyrinth keeps."""

import pickle
import re
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.brute_force import (
    WAYS,
    grid_passages,
    is_connected,
    keeps_the_rules,
    labyrinth_of,
    passages_of,
    reachable,
    structure_with,
    world_of,
)
from support.strategies import labyrinths, randoms, structures

from labyrinth_core.checks import whole
from labyrinth_core.world import (
    Action,
    Labyrinth,
    LabyrinthError,
    Look,
    Structure,
    Task,
    sample_labyrinth,
)

# Passages.


@given(structures())
def test_passages_and_moves_show_the_bits_that_define_a_structure(structure):
    height, width, expected = structure.height, structure.width, passages_of(structure)
    pairs = [frozenset(divmod(cell, width) for cell in pair) for pair in structure.passages()]
    assert Counter(pairs) == Counter(expected)
    for cell, targets in enumerate(structure.moves):
        row, column = divmod(cell, width)
        for target, (rows, columns) in zip(targets, WAYS.values(), strict=True):
            ahead = (row + rows, column + columns)
            is_open = frozenset({(row, column), ahead}) in expected
            assert divmod(target, width) == (ahead if is_open else (row, column))
    ways = Counter(place for pair in expected for place in pair)
    assert structure.junctions == sum(count > 2 for count in ways.values())
    assert structure.dead_ends == sum(count == 1 for count in ways.values())
    assert structure.loops == len(expected) - structure.cells + 1
    assert structure.is_connected == is_connected(height, width, expected)


@given(structures(), randoms)
def test_from_passages_takes_the_passages_in_any_order_and_direction(structure, random):
    pairs = [random.sample(pair, 2) for pair in structure.passages()]
    random.shuffle(pairs)
    twice = pairs + pairs
    assert Structure.from_passages(structure.height, structure.width, twice) == structure


@given(structures())
def test_a_structure_is_read_back_from_its_bytes_which_are_as_few_as_hold_it(structure):
    packed = structure.to_bytes()
    assert Structure.from_bytes(structure.height, structure.width, packed) == structure
    assert 8 * len(packed) - 7 <= 2 * structure.cells <= 8 * len(packed)


def test_the_bytes_of_a_structure_are_those_in_the_files_of_candidates():
    structure = Structure.from_passages(2, 3, [(0, 3), (1, 2), (4, 5)])
    assert structure.to_bytes() == bytes([0b1000_0001, 0b0000_0100])


@pytest.mark.parametrize("pair", [(0, 2), (2, 3), (0, 0), (0, 4), (5, 8), (-1, 0), (-3, 0)])
def test_a_passage_between_cells_that_are_no_neighbours_is_refused(pair):
    with pytest.raises(ValueError, match="of a 2x3 grid are not neighbours"):
        Structure.from_passages(2, 3, [pair])


@pytest.mark.parametrize(
    ("up", "right", "field"),
    [
        (0b001000, 0, "up"),
        (1 << 6, 0, "up"),
        (-1, 0, "up"),
        (0, 0b000100, "right"),
        (0, 0b100000, "right"),
        (0, 1 << 6, "right"),
        (0, -1, "right"),
    ],
)
def test_a_passage_out_of_the_grid_is_refused(up, right, field):
    with pytest.raises(ValueError, match=f"^{field}: a passage leads out of the grid"):
        Structure(2, 3, up, right)


@pytest.mark.parametrize("make", [Structure, Structure.without_walls, Structure.from_passages])
@pytest.mark.parametrize(
    ("height", "width", "message"),
    [
        (1, 3, "height=1"),
        (3, 1, "width=1"),
        (10**6, 5, "height=1000000"),
        (3, 1001, "width=1001"),
        (True, 3, "height=True"),
        (3, 3.0, "width=3.0"),
    ],
)
def test_a_structure_of_a_wrong_size_is_refused(make, height, width, message):
    others = {Structure: (0, 0), Structure.from_passages: ([],)}.get(make, ())
    with pytest.raises(ValueError, match=f"^{message}: give a whole number from 2 to 1000$"):
        make(height, width, *others)


def test_numbers_of_numpys_are_as_good_as_pythons():
    """A cell above 62 of NumPy's would not fit into a set of bits."""
    rows = np.int8(10)
    structure = Structure.without_walls(rows, np.int64(10))
    plain = Structure.without_walls(10, 10)
    assert structure == Structure(rows, rows, plain.up, plain.right) == plain
    assert structure == Structure.from_passages(rows, rows, plain.passages())
    cells = np.arange(100)
    ours = Labyrinth(structure, 0, 99, Task.ICY_FLOOR, ice=frozenset({70}))
    theirs = Labyrinth(structure, cells[0], cells[99], Task.ICY_FLOOR, ice=frozenset({cells[70]}))
    assert theirs == ours
    assert {type(cell) for cell in (theirs.start, theirs.goal, *theirs.ice)} == {int}
    assert structure.least_moves(theirs.start, theirs.goal) == 18
    with pytest.raises(ValueError, match=r"^goal=True: give a whole number$"):
        Labyrinth(structure, 0, True)


@pytest.mark.parametrize("look", Look)
@pytest.mark.parametrize("task", Task)
def test_task_and_look_as_texts_and_any_collection_of_ice_are_those_of_enum_and_set(task, look):
    labyrinth = replace(sample_labyrinth(4, 4, task, np.random.default_rng(0)), look=look)
    drawn = sample_labyrinth(4, 4, str(task), np.random.default_rng(0))
    texts = replace(drawn, look=str(look), task=str(task), ice=iter(labyrinth.ice))
    assert texts == labyrinth
    assert (texts.task, texts.look) == (task, look)
    assert (type(texts.task), type(texts.look), type(texts.ice)) == (Task, Look, frozenset)


@pytest.mark.parametrize(("name", "choices"), [("task", Task), ("look", Look)])
def test_another_task_or_look_is_refused_with_those_there_are(name, choices):
    with pytest.raises(LabyrinthError, match=f"^{name}=mud: choose one of {', '.join(choices)}$"):
        Labyrinth(Structure.without_walls(3, 3), 0, 8, **{name: "mud"})


# Distances.


@given(structures(), st.data())
def test_distances_never_enter_blocked_cells(structure, data):
    cells = st.integers(0, structure.cells - 1)
    source = data.draw(cells)
    blocked = data.draw(st.sets(cells.filter(lambda cell: cell != source), max_size=5))
    distances = structure.distances(source, blocked)
    within_reach = reachable(
        passages_of(structure),
        divmod(source, structure.width),
        [divmod(cell, structure.width) for cell in blocked],
    )
    assert distances[source] == 0
    for cell, distance in enumerate(distances):
        before = {distances[beside] for beside in structure.moves[cell] if beside != cell}
        if divmod(cell, structure.width) not in within_reach:
            assert distance == -1
        elif cell != source:
            assert distance == min(before - {-1}) + 1


# Identity.


@pytest.mark.parametrize(
    ("structure", "structure_id"),
    [
        (Structure(2, 3, 0b101, 0b010001), "3d0b8b09680c5edf"),
        (Structure(5, 5, 0xFFFFF, 0), "33101e57e1df2199"),
    ],
)
def test_a_structure_id_is_the_same_on_every_machine(structure, structure_id):
    assert structure.structure_id == structure_id


@given(labyrinths())
def test_a_pickle_leaves_out_what_can_be_computed(labyrinth):
    held = pickle.dumps(labyrinth)
    again = pickle.loads(held)
    assert again == labyrinth
    assert again.structure.moves == labyrinth.structure.moves
    assert again.cell_distances == labyrinth.cell_distances
    assert labyrinth.structure.structure_id
    assert pickle.dumps(labyrinth) == held


# Symmetries.


def image(structure, turn):
    """Return the structure with each place moved, and the shape that holds them all."""
    moved = {frozenset(turn(*place) for place in pair) for pair in passages_of(structure)}
    corner = turn(structure.height - 1, structure.width - 1)
    opposite = turn(0, 0)
    height, width = (abs(a - b) + 1 for a, b in zip(corner, opposite, strict=True))
    low = [min(pair) for pair in zip(corner, opposite, strict=True)]
    shifted = {frozenset((r - low[0], c - low[1]) for r, c in pair) for pair in moved}
    return structure_with(height, width, shifted)


@given(structures())
def test_the_symmetries_are_the_four_turns_and_their_mirror_images(structure):
    turns = [lambda r, c, a=a, b=b: (a * r, b * c) for a in (1, -1) for b in (1, -1)]
    turns += [lambda r, c, a=a, b=b: (a * c, b * r) for a in (1, -1) for b in (1, -1)]
    images = structure.symmetries()
    assert images[0] == structure
    assert structure.transposed() == image(structure, lambda row, column: (column, row))
    assert structure.mirrored() == image(structure, lambda row, column: (row, -column))
    assert Counter(images) == Counter(image(structure, turn) for turn in turns)


@given(structures())
def test_a_structure_and_its_mirror_image_on_the_diagonal_have_one_canonical_form(structure):
    canonical = structure.canonical()
    assert canonical in (structure, structure.transposed())
    assert structure.transposed().canonical() == canonical == canonical.canonical()
    assert canonical.height <= canonical.width
    if structure.height == structure.width:
        images = (structure, structure.transposed())
        assert (canonical.up, canonical.right) == min((each.up, each.right) for each in images)


# The rules of a labyrinth.


@st.composite
def worlds_near_the_rules(draw):
    """A labyrinth with up to three things changed, which may or may not break a rule."""
    labyrinth = draw(labyrinths())
    task, world, random = labyrinth.task, world_of(labyrinth), draw(randoms)
    for _ in range(random.randint(0, 3)):
        margin = random.choice([0, 0, 0, 1])
        place = (random.randrange(world.height + margin), random.randrange(world.width))
        passage = random.choice(grid_passages(world.height, world.width))
        change = random.choice(["task", "start", "goal", "key", "door", "no key", "ice", "wall"])
        if change == "task":
            task = random.choice(list(Task))
        elif change == "no key":
            world = replace(world, key=None)
        elif change == "ice":
            world = replace(world, ice=world.ice ^ {place})
        elif change == "wall":
            world = replace(world, passages=world.passages ^ {passage})
        elif change in ("start", "goal") or task is Task.KEY_AND_DOOR:
            world = replace(world, **{change: place})
    return task, world


@given(worlds_near_the_rules())
def test_a_labyrinth_is_refused_exactly_when_it_breaks_a_rule(task_and_world):
    task, world = task_and_world
    if keeps_the_rules(world, task):
        assert world_of(labyrinth_of(world, task)) == world
    else:
        with pytest.raises(LabyrinthError):
            labyrinth_of(world, task)


ROOM = world_of(Labyrinth(Structure.without_walls(3, 3), 0, 8))
LOCKED = {"key": (0, 1), "door": (1, 0)}


@pytest.mark.parametrize(
    ("changes", "task", "message", "cell"),
    [
        ({"start": (3, 0)}, "navigation", "the start is outside the grid: cell 9", None),
        ({"goal": (-1, 0)}, "navigation", "the goal is outside the grid: cell -3", None),
        ({"key": (0, 1)}, "navigation", "only key_and_door has a key and a door", None),
        ({"door": (0, 1)}, "icy_floor", "only key_and_door has a key and a door", None),
        ({"door": (0, 1)}, "key_and_door", "and needs both", None),
        ({"ice": {(0, 1)}}, "navigation", "only icy_floor has ice", None),
        ({}, "icy_floor", "only icy_floor has ice, and needs some", None),
        ({"ice": {(2, 2)}}, "icy_floor", "the goal and the ice share a cell", 8),
        ({"ice": {(3, 1)}}, "icy_floor", "the ice is outside the grid: cell 10", None),
        (LOCKED | {"door": (0, 1)}, "key_and_door", "the key and the door share a cell", 1),
        (LOCKED | {"key": (0, 0)}, "key_and_door", "the start and the key share a cell", 0),
    ],
)
def test_a_broken_rule_that_no_text_can_break_is_named_with_the_cell(changes, task, message, cell):
    with pytest.raises(LabyrinthError, match=message) as caught:
        labyrinth_of(replace(ROOM, **changes), Task(task))
    assert caught.value.cell == cell


# Numbers.


KINDS = [int, np.int8, np.uint8, np.int16, np.uint16, np.int32, np.uint32, np.int64, np.uint64]


@pytest.mark.parametrize("kind", KINDS)
def test_a_whole_number_of_any_kind_becomes_one_of_pythons(kind):
    number = whole("size", kind(5), 5, 5)
    assert (number, type(number)) == (5, int)
    assert whole("seed", 2**70, 0) == 2**70
    assert type(whole("action", Action.LEFT)) is int


@pytest.mark.parametrize(
    "value",
    [True, np.True_, 5.0, np.float64(5), np.timedelta64(5), "5", b"5", None, [5], np.array([5])],
    ids=repr,
)
def test_what_is_no_whole_number_is_refused_with_what_is_allowed(value):
    with pytest.raises(ValueError, match=rf"^size={re.escape(repr(value))}: give a whole number$"):
        whole("size", value)


@pytest.mark.parametrize(
    ("value", "bounds", "message"),
    [
        (1, (2, 9), "size=1: give a whole number from 2 to 9"),
        (np.int64(10), (2, 9), r"size=np.int64\(10\): give a whole number from 2 to 9"),
        (-1, (0,), "size=-1: give a whole number from 0 on"),
    ],
)
def test_a_number_out_of_bounds_is_refused_with_the_bounds(value, bounds, message):
    with pytest.raises(ValueError, match=f"^{message}$"):
        whole("size", value, *bounds)

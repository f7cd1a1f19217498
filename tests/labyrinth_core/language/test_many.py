"""Texts parsed together: those that are parsed one by one, or nothing; and written together."""

from copy import copy
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.strategies import labyrinths

from labyrinth_core.language import LabyrinthSyntaxError, dump, dump_many, parse, parse_many
from labyrinth_core.world import Look, Structure, Structures, Task, sample_labyrinth


@st.composite
def texts(draw: st.DrawFn) -> list[str]:
    """Canonical texts of labyrinths of one size, task and look."""
    first = replace(draw(labyrinths()), look=draw(st.sampled_from(Look)))
    height, width = first.structure.height, first.structure.width
    rng = np.random.default_rng(draw(st.integers(0, 99)))
    more = draw(st.integers(0, 3)) if min(height, width) > 2 else 0
    others = [sample_labyrinth(height, width, first.task, rng) for _ in range(more)]
    found = [first, *(replace(each, look=first.look) for each in others)]
    return [dump(labyrinth) for labyrinth in found]


def assert_those_of(found, texts):
    for place, text in enumerate(texts):
        labyrinth = parse(text)
        tiles = [labyrinth.start, labyrinth.goal, labyrinth.key, labyrinth.door]
        assert dump(labyrinth) == text
        assert found.structures[place] == labyrinth.structure
        assert (found.task, found.look) == (labyrinth.task, labyrinth.look)
        assert found.tiles[place].tolist() == [cell for cell in tiles if cell is not None]
        assert set(np.flatnonzero(found.ice[place]).tolist()) == labyrinth.ice


@given(texts())
def test_labyrinths_parsed_together_are_those_parsed_singly(several):
    assert_those_of(parse_many(several), several)


@given(texts(), st.data())
def test_of_a_text_that_was_changed_the_parser_says_the_same_or_is_asked(several, data):
    text = several[-1]
    place = data.draw(st.integers(0, len(text) - 1))
    length = data.draw(st.integers(0, 2))
    new = data.draw(st.text('SEKDI |-+\n"@(0, 1)é', max_size=2))
    several[-1] = text[:place] + new + text[place + length :]
    found = parse_many(several)
    try:
        canonical = dump(parse(several[-1])) == several[-1]
    except LabyrinthSyntaxError:
        canonical = False
    if found is not None:
        assert canonical
        assert_those_of(found, several)


@given(labyrinths(), labyrinths())
def test_labyrinths_that_differ_in_kind_are_left_to_the_parser(first, second):
    alike = (first.size_name, first.task) == (second.size_name, second.task)
    assert (parse_many([dump(first), dump(second)]) is not None) == alike


@pytest.mark.parametrize("opened", [False, True])
@given(labyrinths(), st.data())
def test_labyrinths_that_break_a_rule_are_left_to_the_parser(opened, labyrinth, data):
    # A wall is opened or closed; what can still be solved is as good as before.
    structure, whole = labyrinth.structure, dump(labyrinth)
    height, width, passages = structure.height, structure.width, {*structure.passages()}
    walls = {*Structure.without_walls(height, width).passages()} - passages
    pair = data.draw(st.sampled_from(sorted(walls if opened and walls else passages)))
    changed = Structure.from_passages(height, width, passages ^ {pair})
    unchecked = copy(labyrinth)
    object.__setattr__(unchecked, "structure", changed)
    text = dump(unchecked)
    try:
        parse(text)
    except LabyrinthSyntaxError:
        assert parse_many([text]) is None
        assert parse_many([text, whole]) is None  # Of which the last alone is parsed.
    else:
        assert_those_of(parse_many([text, whole]), [text, whole])


@given(labyrinths(Task.NAVIGATION, Task.PARTIAL_OBSERVABILITY))
def test_a_text_written_with_others_is_the_one_written_alone(labyrinth):
    structure, kind = labyrinth.structure, (labyrinth.start, labyrinth.goal, labyrinth.task)
    others = Structure.without_walls(structure.height, structure.width)
    assert dump_many(Structures.of([others, structure]), *kind)[1] == dump(labyrinth)

import pickle
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import labyrinth_core
from labyrinth_core.language import (
    LabyrinthSyntaxError,
    draw_text,
    dump,
    labyrinth_id,
    load,
    parse,
    parse_edges,
    parse_size,
)
from labyrinth_core.world import (
    SIDES,
    TILES,
    Labyrinth,
    LabyrinthError,
    Placer,
    Solver,
    Structure,
    Task,
    identity,
)

ROOT = Path(__file__).parents[3]
VALID = ROOT / "tests" / "data" / "valid"

CHARACTERS = [
    *' |+-"SEKDIsex:,;()[]019\n\r\t\0\x1b\ufeff\u2028\xa0\xe9\U0001f600\ud800',
    '"""',
    "\r\n",
]
PHRASES = [
    "labyrinth:",
    "end",
    "icy_floor: True",
    "key_and_lock: true",
    "occlusion:True",
    '"""',
    "",
]


def random_labyrinth(rng: np.random.Generator) -> Labyrinth:
    """Return a labyrinth of a random size and task, not always with a connected structure."""
    height, width = (int(side) for side in rng.integers(2, 8, size=2))
    open_walls = float(rng.choice([0.0, 0.1, 0.7]))
    structure = next(Structure.sample(height, width, rng, open_walls=open_walls))
    start, goal = (int(cell) for cell in rng.choice(structure.cells, size=2, replace=False))
    if rng.random() < 0.2:
        up = structure.up & int.from_bytes(rng.bytes(8), "little")
        structure = Structure(height, width, up, structure.right)
    try:
        labyrinth = Placer(rng).place(structure, start, goal, list(Task)[rng.integers(4)])
    except LabyrinthError:
        return random_labyrinth(rng)
    return labyrinth


def edge_list(labyrinth: Labyrinth) -> str:
    """Return a labyrinth as an edge list, the older format."""
    tiles = [labyrinth.start, labyrinth.goal]
    if labyrinth.key is not None and labyrinth.door is not None:
        tiles += [labyrinth.key, labyrinth.door]
    parts = [str(list(labyrinth.structure.passages()))]
    parts += [str(labyrinth.position(cell)) for cell in tiles]
    if labyrinth.ice:
        parts.append(str([labyrinth.position(cell) for cell in sorted(labyrinth.ice)]))
    return ";".join(parts)


def damage(text: str, rng: np.random.Generator) -> str:
    """Return a text after one random edit."""
    edit = int(rng.integers(9))
    place = int(rng.integers(len(text) + 1))
    character: str = CHARACTERS[rng.integers(len(CHARACTERS))]
    if edit == 0:
        return text[:place] + character + text[place:]
    if edit == 1:
        return text[:place] + character + text[place + 1 :]
    if edit == 2:
        return text[:place] + text[place + 1 :]
    if edit == 3:
        return text.replace("SEKDI"[rng.integers(5)], " ")
    if edit == 4:
        return text.replace("False", "True", 1)
    if edit == 5:
        other = int(rng.integers(len(text) + 1))
        return text[:place] + text[min(place, other) : max(place, other)] + text[place:]
    lines = text.split("\n")
    line = int(rng.integers(len(lines)))
    if edit == 6:
        lines[line] = PHRASES[rng.integers(len(PHRASES))]
    elif edit == 7:
        lines.insert(line, lines[rng.integers(len(lines))])
    else:
        lines[line] += f' """{character}""" '
    return "\n".join(lines)


def damaged_texts(count: int, rng: np.random.Generator) -> Iterator[str]:
    """Yield texts: labyrinths in both formats with zero to five edits, and some random bytes."""
    for _ in range(count):
        kind = rng.random()
        if kind < 0.05:
            yield rng.bytes(int(rng.integers(200))).decode("latin-1")
            continue
        labyrinth = random_labyrinth(rng)
        text = dump(labyrinth) if kind < 0.85 else edge_list(labyrinth)
        for _ in range(int(rng.integers(6))):
            text = damage(text, rng)
        yield text


def accepting(text: str) -> int:
    """Return the number of parsers, of the two, that accept a text.

    Raises:
        AssertionError: A labyrinth or an error is wrong.
    """
    accepted = 0
    for parser in (parse, parse_edges):
        try:
            labyrinth = parser(text)
        except LabyrinthSyntaxError as error:
            _check_error(text, error)
        else:
            accepted += 1
            canonical = dump(labyrinth)
            again = parse(canonical)
            assert again == labyrinth, "the dumped text gives another labyrinth"
            assert dump(again) == canonical, "the dumped text is not canonical"
    return accepted


def _check_error(text: str, error: LabyrinthSyntaxError) -> None:
    lines = text.removeprefix("\ufeff").replace("\r\n", "\n").replace("\r", "\n").split("\n")
    assert error.source_line == lines[error.line - 1], "the error shows another line"
    assert 1 <= error.column <= len(error.source_line) + 1, "the column is outside the line"
    message = str(error)
    assert message.count("\n") == 2, "the message has not three lines"
    assert message.replace("\n", "").isprintable(), "the message has control characters"
    assert len(message) < 500, "the message is long"
    assert str(pickle.loads(pickle.dumps(error))) == message, "the error does not survive pickling"


TINY = """\
key_and_lock: False
icy_floor: False
occlusion: False

labyrinth:
---------
|   | E |
|   +   |
| S     |
---------
end
"""


def mistake(text, **options):
    with pytest.raises(LabyrinthSyntaxError) as caught:
        parse(text, **options)
    return caught.value


def test_a_syntax_error_is_a_public_labyrinth_error_without_a_cell():
    error = mistake("labyrinth:")
    assert isinstance(error, labyrinth_core.LabyrinthError)
    assert type(error) is labyrinth_core.LabyrinthSyntaxError
    assert error.cell is None
    assert str(pickle.loads(pickle.dumps(error))) == str(error)


labyrinths = st.integers(0, 2**32 - 1).map(
    lambda seed: random_labyrinth(np.random.default_rng(seed))
)
"""Labyrinths of every task, connected or not, with the agent here or there."""


@given(labyrinths)
def test_a_labyrinth_and_its_canonical_text_come_back_the_same(labyrinth):
    text = dump(labyrinth)
    assert parse(text) == labyrinth
    assert dump(parse(text)) == text


@given(labyrinths, st.text(max_size=20), st.data())
def test_a_comment_at_the_end_of_any_line_changes_nothing(labyrinth, comment, data):
    lines = dump(labyrinth).split("\n")
    line = data.draw(st.integers(0, len(lines) - 1))
    lines[line] += f' """{comment.replace(chr(34), "")}"""'
    assert parse("\n".join(lines)) == labyrinth


@pytest.mark.slow
def test_thousands_of_damaged_texts_are_labyrinths_or_syntax_errors():
    accepted = [accepting(text) > 0 for text in damaged_texts(4_000, np.random.default_rng(20))]
    assert 400 < sum(accepted) < 2_000


@pytest.mark.parametrize(
    ("figure", "task", "route", "tiles"),
    [
        ("1a_navigation", Task.NAVIGATION, [0, 1, 0, 1], [None, None]),
        ("1b_partial_observability", Task.PARTIAL_OBSERVABILITY, [0, 1, 0, 1], [None, None]),
        ("1c_key_and_door", Task.KEY_AND_DOOR, [0, 1, 1, 2, 0, 3, 0, 1], [2, 7]),
        ("1d_ice_floor", Task.ICY_FLOOR, [0, 1, 0, 1], [None, None, 1, 2, 5]),
    ],
)
def test_the_figures_of_the_supplement_have_these_solutions(figure, task, route, tiles):
    labyrinth = load(VALID / f"figure_{figure}.labyrinth")
    found = [labyrinth.key, labyrinth.door, *sorted(labyrinth.ice)]
    assert (labyrinth.task, labyrinth.start, labyrinth.goal, found) == (task, 0, 8, tiles)
    assert Solver(labyrinth).shortest_routes() == [route]


def test_the_identity_is_that_of_the_canonical_text():
    assert labyrinth_id(parse(TINY)) == labyrinth_id(TINY) == identity(TINY)
    assert labyrinth_id(TINY) == "3a0122bccc76c92e"


def test_missing_tiles_follow_from_the_seed():
    text = (VALID / "missing_key_and_door_are_placed.labyrinth").read_text()
    placed = [parse(text, seed=seed) for seed in range(30)]
    assert placed == [parse(text, seed=seed) for seed in np.arange(30)]
    with pytest.raises(ValueError, match=r"^seed=True: give a whole number from 0 on$"):
        parse(text, seed=True)
    assert len(set(placed)) > 1


def test_an_error_knows_place_line_and_what_was_expected():
    error = mistake(TINY.replace("| S ", "| s "), file="mine.labyrinth")
    assert (error.file, error.line, error.column) == ("mine.labyrinth", 9, 3)
    assert (error.message, error.source_line) == ("in a line of cells", "| s     |")
    letters = ", ".join(["S", "E", *(tile.letter for tile in TILES)])
    assert (error.expected, error.found) == (f"{letters} or a blank", "'s'")
    assert str(pickle.loads(pickle.dumps(error))) == str(error)


def test_what_is_too_long_is_refused(tmp_path):
    most = 32 * 1024 * 1024
    assert most > 3 * (4 * 1_000 + 2) * (2 * 1_000 + 1), "the largest drawing has to fit"
    error = mistake(TINY + " " * most)
    assert error.message == "the text is too long"
    assert len(str(error)) < 300
    path = tmp_path / "long.labyrinth"
    path.write_bytes(b"\n" * (most + 1))
    with pytest.raises(LabyrinthSyntaxError, match=r"long\.labyrinth:1:1: the file is too long"):
        load(str(path))
    rows = "|   |   |\n|   +   |\n" * 1_000
    error = mistake(f"labyrinth:\n---------\n{rows}| S   E |\n---------\nend\n")
    assert (error.line, error.message) == (2_002, "the drawing is too tall")


@pytest.mark.parametrize(("height", "width"), [(1_000, 2), (2, 1_000)])
def test_a_labyrinth_with_as_many_rows_or_columns_as_may_be_comes_back_the_same(height, width):
    labyrinth = Labyrinth(Structure.without_walls(height, width), 0, height * width - 1)
    assert parse(dump(labyrinth)) == labyrinth


def test_missing_tiles_are_placed_in_a_huge_labyrinth_too():
    structure = next(Structure.sample(60, 60, np.random.default_rng(0)))
    for setting in ("key_and_lock", "icy_floor"):
        text = dump(Labyrinth(structure, 0, 3_599)).replace(f"{setting}: False", f"{setting}: True")
        assert parse(text).structure == structure


@given(labyrinths.filter(lambda labyrinth: labyrinth.task is not Task.PARTIAL_OBSERVABILITY))
def test_the_list_of_edges_gives_the_same_labyrinth(labyrinth):
    height, width = labyrinth.structure.height, labyrinth.structure.width
    assert parse_edges(edge_list(labyrinth), height=height, width=width) == labyrinth


def test_a_list_of_edges_without_a_size_is_the_smallest_square():
    assert parse_edges("[(0, 1), (1, 3), (0, 2)]; (0, 0); (1, 1)\n") == parse(TINY)
    assert parse_edges("[(0,1)];(0,0);(0,1)", height=3).size_name == "3x3"
    assert parse_edges("[(0,3),(3,6)];(0,0);(2,0)").size_name == "3x3"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("__import__('os')", "1:1: in a list of edges: expected '[', found '_'"),
        ("[(0, 1)", "1:8: in a list of edges: expected ',' or ']', found the end of the text"),
        ("[(0, 1),];(0, 0);(1, 1)", "1:9: in a list of edges: expected '(', found ']'"),
        (
            "[(0, ²)];(0, 0);(1, 1)",
            "1:6: in a list of edges: expected a whole number of at most six digits, found '²'",
        ),
        ("[(0, 1)];(0, 0)", "1:16: in a list of edges: expected ';', found the end of the text"),
        ("[(0, 1)];(0, 0);(0, 1) x", "1:24: in a list of edges: expected ';', found 'x'"),
        (
            "[(0, 1),\n (1, 2)];(0, 0);(0, 1)",
            "2:2: in an edge: expected neighbouring cells of a 2x2 grid "
            "(name its size if it is another), found 1 and 2",
        ),
        ("[(0, 1)];(0, 0);(1, 1)", "1:17: no route leads from start to goal"),
        ("[(0, 1)];(0, 0);(0, 0)", "1:17: the start and the goal share a cell"),
    ],
)
def test_a_mistake_in_a_list_of_edges_is_located(text, message):
    with pytest.raises(LabyrinthSyntaxError) as caught:
        parse_edges(text)
    assert str(caught.value).split("\n")[0] == f"<text>:{message}"


def test_tiles_and_edges_outside_a_given_size_are_refused():
    with pytest.raises(LabyrinthSyntaxError, match=r"expected a \(row, column\) of a 2x2 grid"):
        parse_edges("[(0, 1)];(0, 0);(2, 1)", height=2, width=2)
    with pytest.raises(LabyrinthSyntaxError, match="the size does not fit"):
        parse_edges("[(0, 1)];(0, 0);(0, 1)", height=1, width=2)
    with pytest.raises(LabyrinthSyntaxError, match="the size does not fit"):
        parse_edges("[(0, 1)];(0, 0);(0, 9999)")


def test_hidden_cells_are_covered_and_their_walls_too():
    text = (VALID / "figure_1a_navigation.labyrinth").read_text()
    labyrinth = parse(text.replace("occlusion: False", "occlusion: True"))
    assert draw_text(labyrinth, labyrinth.initial).split("\n")[1:6] == [
        "|   | ? ? E |",
        "|   + ? + ? |",
        "|     ? ? ? |",
        "|   + - + ? |",
        "| @     | ? |",
    ]


# Sizes.

valid_sides = st.sampled_from(SIDES)


@given(valid_sides, valid_sides)
def test_a_size_is_height_by_width_and_one_number_a_square(height, width):
    assert parse_size(f"{height}x{width}") == (height, width)
    assert parse_size(str(height)) == (height, height)


@pytest.mark.parametrize("text", [" 4x6 ", "4X6", "4 x 6", "04x6"])
def test_a_size_may_be_written_loosely(text):
    assert parse_size(text) == (4, 6)


@pytest.mark.parametrize(
    "text",
    (
        "|x|1|0|-3|1001|3x|x3|3x1|1x3|3x1001|3x3x3|3,4|3.0|3 4|three|1e1|0x10|"
        "\N{ARABIC-INDIC DIGIT THREE}|3x\N{ARABIC-INDIC DIGIT THREE}|" + "9" * 5000
    ).split("|"),
)
def test_a_size_that_is_none_is_refused_with_what_is_allowed(text):
    with pytest.raises(ValueError, match=r"^size=.*: give a whole number from 2 to 1,000 such as"):
        parse_size(text)

"""Random labyrinths, and texts of them with random damage, for the tests of the parsers."""

from __future__ import annotations

import pickle
from collections.abc import Iterator

import numpy as np

from labyrinth_core.language import LabyrinthSyntaxError, dump, parse, parse_edges
from labyrinth_core.world import Labyrinth, LabyrinthError, Placer, Structure, Task

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


def inputs(count: int, rng: np.random.Generator) -> Iterator[str]:
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


def check(text: str) -> int:
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

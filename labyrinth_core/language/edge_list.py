"""The form in which labyrinths were once kept: a list of edges, then start and goal.

    [(0, 1), (1, 2), (0, 3)];(0, 0);(1, 2)

Edges join cells given as `row * width + column`; start and goal are given as (row, column). Key
and door, `;(0, 2);(1, 1)`, or a list of ice, `;[(0, 1), (1, 1)]`, may follow.
"""

from __future__ import annotations

import re
from math import isqrt
from typing import NoReturn

from labyrinth_core.language.source_text import LabyrinthSyntaxError, describe, normalised
from labyrinth_core.world.grid import MAX_SIDE, MIN_SIDE, cell_at, neighbours
from labyrinth_core.world.labyrinth import Labyrinth, LabyrinthError, Structure, Task

Place = tuple[int, tuple[int, int]]
"""The offset of a pair of numbers in the text, and the pair."""

_NUMBER = re.compile(r"[0-9]{1,6}(?![0-9])")


def parse_edges(
    text: str, *, height: int | None = None, width: int | None = None, file: str | None = None
) -> Labyrinth:
    """Return the labyrinth that a list of edges describes.

    text = pairs ";" pair ";" pair [";" pair ";" pair | ";" pairs]

    Args:
        text: The list, with start and goal and, if there are any, the tiles of a task.
        height: Rows; as many as columns if it is left out.
        width: Columns; as many as rows if it is left out. Without both, the labyrinth is the
            smallest square that has all the cells named.
        file: Name of the file it comes from, for messages.

    Raises:
        LabyrinthSyntaxError: The text is no such list, or the labyrinth breaks a rule.
    """
    reader = _Reader(text, file)
    edges = reader.pairs()
    tiles = [reader.next_pair(), reader.next_pair()]
    task = Task.NAVIGATION
    if not reader.at_end():
        reader.take(";")
        if not reader.sees("["):
            tiles += [reader.pair(), reader.next_pair()]
            task = Task.KEY_AND_DOOR
        elif ice := reader.pairs():
            tiles += ice
            task = Task.ICY_FLOOR
    if not reader.at_end():
        reader.fail("the end of the text")
    height, width = width if height is None else height, height if width is None else width
    if height is None or width is None:
        last_cell = max((cell for _, pair in edges for cell in pair), default=0)
        last_line = max(line for _, pair in tiles for line in pair)
        height = width = max(MIN_SIDE, last_line + 1, isqrt(last_cell) + 1)
    structure = _structure(reader, height, width, edges)
    return _build(reader, structure, tiles, task)


def _structure(reader: _Reader, height: int, width: int, edges: list[Place]) -> Structure:
    size = f"{height}x{width}"
    if not (MIN_SIDE <= height <= MAX_SIDE and MIN_SIDE <= width <= MAX_SIDE):
        sides = f"{MIN_SIDE} to {MAX_SIDE:,} rows and columns"
        raise reader.error(0, "the size does not fit", sides, size)
    for offset, (a, b) in edges:
        low, high = min(a, b), max(a, b)
        if high >= height * width or high not in neighbours(low, height, width).values():
            expected = f"neighbouring cells of a {size} grid (name its size if it is another)"
            raise reader.error(offset, "in an edge", expected, f"{a} and {b}")
    return Structure.from_passages(height, width, (edge for _, edge in edges))


def _build(reader: _Reader, structure: Structure, tiles: list[Place], task: Task) -> Labyrinth:
    for offset, (row, column) in tiles:
        if row >= structure.height or column >= structure.width:
            expected = f"a (row, column) of a {structure.height}x{structure.width} grid"
            raise reader.error(offset, "in a tile", expected, f"({row}, {column})")
    cells = [cell_at(row, column, structure.width) for _, (row, column) in tiles]
    start, goal, *others = cells
    key, door = others if task is Task.KEY_AND_DOOR else (None, None)
    ice = frozenset(others if task is Task.ICY_FLOOR else ())
    try:
        return Labyrinth(structure, start, goal, task, key, door, ice)
    except LabyrinthError as error:
        places: dict[int | None, int] = dict(zip(cells, (at for at, _ in tiles), strict=True))
        raise reader.error(places.get(error.cell, 0), str(error)) from error


class _Reader:
    """A text read from left to right; blanks after what is read are skipped."""

    def __init__(self, text: str, file: str | None) -> None:
        self.text = normalised(text, file)
        self.file = file
        self.position = 0
        self.skip(0)

    def at_end(self) -> bool:
        return self.position == len(self.text)

    def sees(self, char: str) -> bool:
        return self.text.startswith(char, self.position)

    def skip(self, length: int) -> None:
        self.position += length
        while self.text.startswith((" ", "\t", "\n"), self.position):
            self.position += 1

    def take(self, char: str) -> None:
        if not self.sees(char):
            self.fail(f"'{char}'")
        self.skip(1)

    def number(self) -> int:
        match = _NUMBER.match(self.text, self.position)
        if not match:
            self.fail("a whole number of at most six digits")
        self.skip(len(match[0]))
        return int(match[0])

    def pair(self) -> Place:
        """Return the pair that comes next.

        pair = "(" number "," number ")"
        """
        start = self.position
        self.take("(")
        first = self.number()
        self.take(",")
        second = self.number()
        self.take(")")
        return start, (first, second)

    def next_pair(self) -> Place:
        self.take(";")
        return self.pair()

    def pairs(self) -> list[Place]:
        """Return the pairs of the list that comes next.

        pairs = "[" [pair {"," pair}] "]"
        """
        self.take("[")
        found: list[Place] = []
        if not self.sees("]"):
            found.append(self.pair())
            while self.sees(","):
                self.take(",")
                found.append(self.pair())
            if not self.sees("]"):
                self.fail("',' or ']'")
        self.take("]")
        return found

    def error(
        self, offset: int, message: str, expected: str | None = None, found: str | None = None
    ) -> LabyrinthSyntaxError:
        return LabyrinthSyntaxError.at(self.text, offset, message, self.file, expected, found)

    def fail(self, expected: str) -> NoReturn:
        found = describe(self.text, self.position)
        raise self.error(self.position, "in a list of edges", expected, found)

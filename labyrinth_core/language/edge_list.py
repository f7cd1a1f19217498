"""The form in which labyrinths were once kept: a list of edges, then start and goal.

    [(0, 1), (1, 2), (0, 3)];(0, 0);(1, 2)

Edges join cells given as `row * width + column`; start and goal are given as (row, column). Key
and door, `;(0, 2);(1, 1)`, or a list of ice, `;[(0, 1), (1, 1)]`, may follow.
"""

from __future__ import annotations

import re
from typing import NoReturn

from labyrinth_core.language.source_text import LabyrinthSyntaxError, describe, normalised
from labyrinth_core.world.grid import MAX_SIDE, MIN_SIDE, cell_at, neighbours
from labyrinth_core.world.labyrinth import Labyrinth, LabyrinthError, Structure, Task

Pair = tuple[int, int]

_BLANKS = re.compile(r"[ \t\n]*")
_NUMBER = re.compile(r"[0-9]{1,6}(?![0-9])")
_PAIR = re.compile(r"\(B([0-9]{1,6})B,B([0-9]{1,6})B\)".replace("B", _BLANKS.pattern))


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
    tiles: dict[str, tuple[int, Pair]] = {}
    for name in ("start", "goal"):
        reader.take(";")
        tiles[name] = reader.pair()
    ice: list[tuple[int, Pair]] = []
    if not reader.at_end():
        reader.take(";")
        if reader.sees("["):
            ice = reader.pairs()
        else:
            tiles["key"] = reader.pair()
            reader.take(";")
            tiles["door"] = reader.pair()
    if not reader.at_end():
        reader.fail("the end of the text")
    height, width = width if height is None else height, height if width is None else width
    if height is None or width is None:
        height = width = _smallest_square(edges, [*tiles.values(), *ice])
    return _build(reader, height, width, edges, tiles, ice)


def _smallest_square(edges: list[tuple[int, Pair]], tiles: list[tuple[int, Pair]]) -> int:
    """Return the side of the smallest square that has all the cells."""
    last_cell = max((cell for _, pair in edges for cell in pair), default=0)
    last_line = max(line for _, pair in tiles for line in pair)
    side = MIN_SIDE
    while side <= last_line or side * side <= last_cell:
        side += 1
    return side


def _build(
    reader: _Reader,
    height: int,
    width: int,
    edges: list[tuple[int, Pair]],
    tiles: dict[str, tuple[int, Pair]],
    ice: list[tuple[int, Pair]],
) -> Labyrinth:
    size = f"{height}x{width}"
    if not (MIN_SIDE <= height <= MAX_SIDE and MIN_SIDE <= width <= MAX_SIDE):
        sides = f"{MIN_SIDE} to {MAX_SIDE:,} rows and columns"
        raise reader.error(0, "the size does not fit", sides, size)
    for offset, (a, b) in edges:
        low, high = min(a, b), max(a, b)
        if high >= height * width or high not in neighbours(low, height, width).values():
            expected = f"neighbouring cells of a {size} grid (name its size if it is another)"
            raise reader.error(offset, "in an edge", expected, f"{a} and {b}")
    places: dict[int, int] = {}
    cells: list[int] = []
    for offset, (row, column) in [*tiles.values(), *ice]:
        if row >= height or column >= width:
            expected = f"a (row, column) of a {size} grid"
            raise reader.error(offset, "in a tile", expected, f"({row}, {column})")
        cells.append(cell_at(row, column, width))
        places[cells[-1]] = offset
    structure = Structure.from_passages(height, width, (edge for _, edge in edges))
    try:
        if ice:
            return Labyrinth(
                structure, cells[0], cells[1], Task.ICY_FLOOR, ice=frozenset(cells[2:])
            )
        if "key" in tiles:
            start, goal, key, door = cells
            return Labyrinth(structure, start, goal, Task.KEY_AND_DOOR, key, door)
        return Labyrinth(structure, cells[0], cells[1])
    except LabyrinthError as error:
        offset = places.get(-1 if error.cell is None else error.cell, 0)
        raise reader.error(offset, str(error)) from error


class _Reader:
    """A text read from left to right."""

    def __init__(self, text: str, file: str | None) -> None:
        self.text = normalised(text, file)
        self.file = file
        self.position = 0
        self.skip_blanks()

    def skip_blanks(self) -> None:
        blanks = _BLANKS.match(self.text, self.position)
        self.position = blanks.end() if blanks else self.position

    def at_end(self) -> bool:
        return self.position == len(self.text)

    def sees(self, char: str) -> bool:
        return self.text.startswith(char, self.position)

    def take(self, char: str) -> None:
        if not self.sees(char):
            self.fail(f"'{char}'")
        self.position += 1
        self.skip_blanks()

    def number(self) -> int:
        match = _NUMBER.match(self.text, self.position)
        if not match:
            self.fail("a whole number of at most six digits")
        self.position = match.end()
        self.skip_blanks()
        return int(match[0])

    def pair(self) -> tuple[int, Pair]:
        """Return the offset of a pair, and the pair.

        pair = "(" number "," number ")"
        """
        start = self.position
        match = _PAIR.match(self.text, start)
        if match:
            self.position = match.end()
            self.skip_blanks()
            return start, (int(match[1]), int(match[2]))
        self.take("(")
        self.number()
        self.take(",")
        self.number()
        self.take(")")
        raise AssertionError("what is no pair piece by piece is no pair as a whole")

    def pairs(self) -> list[tuple[int, Pair]]:
        """Return the pairs of a list, each with its offset.

        pairs = "[" [pair {"," pair}] "]"
        """
        self.take("[")
        found: list[tuple[int, Pair]] = []
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

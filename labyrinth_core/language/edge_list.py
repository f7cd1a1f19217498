"""Parse lists of edges, an older text form of labyrinths: the edges, then start and goal.

    [(0, 1), (1, 2), (0, 3)];(0, 0);(1, 2)

An edge joins two cells, each given as `row * width + column`; start and goal are given as
(row, column). Key and door, `;(0, 2);(1, 1)`, or a list of ice, `;[(0, 1), (1, 1)]`, may follow.
"""

from __future__ import annotations

import re
from math import isqrt
from typing import NoReturn

from labyrinth_core.language.source_text import LabyrinthSyntaxError, character_at, with_line_feeds
from labyrinth_core.world import SIDES, Labyrinth, LabyrinthError, Structure, Task

_Pair = tuple[int, tuple[int, int]]
"""The offset of a pair of numbers in the text, and the pair."""

_TOKEN = re.compile(r"[0-9]+|[^ \t\n]")


def parse_edges(
    text: str, *, height: int | None = None, width: int | None = None, file: str | None = None
) -> Labyrinth:
    """Return the labyrinth that a list of edges describes.

    text = pairs ";" pair ";" pair [";" pair ";" pair | ";" pairs]

    Args:
        text: The list, with start and goal and the tiles of the task, if it has any.
        height: Rows; None for as many as columns.
        width: Columns; None for as many as rows. If both are None, the labyrinth is the smallest
            square that has all cells of the list.
        file: The name of its file, for messages.

    Raises:
        LabyrinthSyntaxError: The text is not such a list, or the labyrinth breaks a rule.
    """
    reader = _Reader(text, file)
    edges = reader.pairs()
    tiles = [reader.pair(after=";"), reader.pair(after=";")]
    task = Task.NAVIGATION
    if reader.token:
        reader.take(";")
        if reader.token != "[":
            tiles += [reader.pair(), reader.pair(after=";")]
            task = Task.KEY_AND_DOOR
        elif ice := reader.pairs():
            tiles += ice
            task = Task.ICY_FLOOR
    if reader.token:
        reader.fail("the end of the text")
    height, width = width if height is None else height, height if width is None else width
    if height is None or width is None:
        last_cell = max((cell for _, pair in edges for cell in pair), default=0)
        last_line = max(line for _, pair in tiles for line in pair)
        height = width = max(SIDES[0], last_line + 1, isqrt(last_cell) + 1)
    structure = _structure(reader, height, width, edges)
    return _build(reader, structure, tiles, task)


def _structure(reader: _Reader, height: int, width: int, edges: list[_Pair]) -> Structure:
    size = f"{height}x{width}"
    if height not in SIDES or width not in SIDES:
        sides = f"{SIDES[0]} to {SIDES[-1]:,} rows and columns"
        raise reader.error(0, "the size does not fit", sides, size)
    grid = Structure.without_walls(height, width)
    for offset, (a, b) in edges:
        if max(a, b) >= grid.cells or grid.grid_distance(a, b) != 1:
            expected = f"neighbouring cells of a {size} grid (name its size if it is another)"
            raise reader.error(offset, "in an edge", expected, f"{a} and {b}")
    return Structure.from_passages(height, width, (edge for _, edge in edges))


def _build(reader: _Reader, structure: Structure, tiles: list[_Pair], task: Task) -> Labyrinth:
    for offset, (row, column) in tiles:
        if row >= structure.height or column >= structure.width:
            expected = f"a (row, column) of a {structure.height}x{structure.width} grid"
            raise reader.error(offset, "in a tile", expected, f"({row}, {column})")
    cells = [row * structure.width + column for _, (row, column) in tiles]
    start, goal, *others = cells
    key, door = others if task is Task.KEY_AND_DOOR else (None, None)
    ice = frozenset(others if task is Task.ICY_FLOOR else ())
    try:
        return Labyrinth(structure, start, goal, task, key, door, ice)
    except LabyrinthError as error:
        places: dict[int | None, int] = dict(zip(cells, (at for at, _ in tiles), strict=True))
        raise reader.error(places.get(error.cell, 0), str(error)) from error


class _Reader:
    """A text that is read token by token."""

    def __init__(self, text: str, file: str | None) -> None:
        self._text, self._file = with_line_feeds(text, file), file
        self._tokens = _TOKEN.finditer(self._text)
        self._advance()

    def _advance(self) -> None:
        match = next(self._tokens, None)
        self.token = match[0] if match else ""
        """The next token: a number or a character; empty at the end."""
        self._offset = match.start() if match else len(self._text)

    def take(self, token: str) -> None:
        """Consume the next token, which has to be the one given."""
        if self.token != token:
            self.fail(f"'{token}'")
        self._advance()

    def _number(self) -> int:
        token = self.token
        if not (token.isascii() and token.isdigit() and len(token) <= 6):
            self.fail("a whole number of at most six digits")
        self._advance()
        return int(token)

    def pair(self, *, after: str = "") -> _Pair:
        """Read the next pair, after the token `after` if one is given.

        pair = "(" number "," number ")"
        """
        if after:
            self.take(after)
        offset = self._offset
        self.take("(")
        first = self._number()
        self.take(",")
        second = self._number()
        self.take(")")
        return offset, (first, second)

    def pairs(self) -> list[_Pair]:
        """Read the next list of pairs.

        pairs = "[" [pair {"," pair}] "]"
        """
        self.take("[")
        found = [self.pair()] if self.token != "]" else []
        while self.token == ",":
            found.append(self.pair(after=","))
        if self.token != "]":
            self.fail("',' or ']'")
        self._advance()
        return found

    def error(
        self, offset: int, message: str, expected: str | None = None, found: str | None = None
    ) -> LabyrinthSyntaxError:
        """Return the error at an offset of the text."""
        return LabyrinthSyntaxError.at(self._text, offset, message, self._file, expected, found)

    def fail(self, expected: str) -> NoReturn:
        """Raise the error at the next token."""
        found = character_at(self._text, self._offset)
        raise self.error(self._offset, "in a list of edges", expected, found)

"""The drawing in the text language: the structure that its lines show, and the tiles in cells."""

from __future__ import annotations

import re
from typing import NamedTuple, NoReturn

from labyrinth_core.language.source_text import Source
from labyrinth_core.world.grid import MAX_SIDE, MIN_SIDE
from labyrinth_core.world.labyrinth import Structure

_OPEN_IN_TEXT = str.maketrans("| -", "010")


class Drawing(NamedTuple):
    """What a drawing shows."""

    structure: Structure
    tiles: str
    """The character in each cell, cell 0 first."""
    rows: list[int]
    """Offset of the line of each row, the lowest row first."""

    def offset(self, cell: int) -> int:
        """Return the offset of a cell."""
        row, column = divmod(cell, self.structure.width)
        return self.rows[row] + 4 * column + 2


def parse_drawing(source: Source) -> Drawing:
    """Return the structure and the tiles that are drawn.

    drawing = outer-wall cell-line {wall-line cell-line} outer-wall
    cell-line = "|" cell {("|" | " ") cell} "|"
    cell = " " (" " | "S" | "E" | "K" | "D" | "I") " "
    wall-line = "|" wall {"+" wall} "|"
    wall = " " ("-" | " ") " "
    """
    top = _parse_top(source)
    width = len(top) // 4
    cell_line = re.compile(rf"\|(?: [ SEKDI] [| ]){{{width - 1}}} [ SEKDI] \|")
    wall_line = re.compile(rf"\|(?: [- ] \+){{{width - 1}}} [- ] \|")
    rows: list[int] = []
    tiles: list[str] = []
    # Bits as text: the highest row and the last column first, as int() wants them.
    right: list[str] = []
    up: list[str] = ["0" * width]
    while True:
        offset, line = source.next_line()
        if not cell_line.fullmatch(line):
            _refuse_line(source, offset, line, len(top), cells=True)
        rows.append(offset)
        tiles.append(line[2::4])
        right.append("0" + line[-5:0:-4])
        offset, line = source.next_line()
        if line == top:
            break
        if not wall_line.fullmatch(line):
            _refuse_line(source, offset, line, len(top), cells=False)
        if len(rows) == MAX_SIDE:
            source.fail(offset, "the drawing is too high", f"at most {MAX_SIDE:,} rows", "more")
        up.append(line[-3::-4])
    if len(rows) < MIN_SIDE:
        expected = f"{MIN_SIDE} to {MAX_SIDE:,} rows"
        source.fail(offset, "the drawing is too low", expected, str(len(rows)))
    bits = (int("".join(lines).translate(_OPEN_IN_TEXT), 2) for lines in (up, right))
    structure = Structure(len(rows), width, *bits)
    return Drawing(structure, "".join(reversed(tiles)), rows[::-1])


def _parse_top(source: Source) -> str:
    """Return the top line of a drawing, which tells its width.

    outer-wall = "-" {"----"}
    """
    offset, line = source.next_line()
    dashes = len(line) - len(line.lstrip("-"))
    if not line or dashes < len(line):
        expected = "'-'" if dashes else "a line of dashes, the outer wall"
        source.fail(offset + dashes, "in the top line of the drawing", expected)
    width, rest = divmod(dashes - 1, 4)
    if rest or not MIN_SIDE <= width <= MAX_SIDE:
        source.fail(
            offset,
            "the top line of the drawing has the wrong length",
            f"four dashes for each of {MIN_SIDE} to {MAX_SIDE:,} columns, and one more",
            f"{dashes:,} dashes",
        )
    return line


def _refuse_line(source: Source, offset: int, line: str, length: int, *, cells: bool) -> NoReturn:
    """Raise the error for a line inside a drawing that does not show cells, or walls."""
    kind, end = "cells" if cells else "walls", "'|', the outer wall"
    begin = end if cells else f"'|', or {length:,} dashes to end the drawing"
    if not line.strip("-"):
        if line and cells:
            source.fail(offset, "a row is missing", "a line of cells", "an outer wall")
        if line:
            found = f"{len(line):,} dashes"
            source.fail(offset, "in the bottom line of the drawing", f"{length:,} dashes", found)
        source.fail(offset, "the drawing is not complete", begin)
    between = ("| ", "'|' or a blank") if cells else ("+", "'+'")
    inside = (" SEKDI", "S, E, K, D, I or a blank") if cells else ("- ", "'-' or a blank")
    parts = [
        (range(1), "|", begin),
        (range(length - 1, length), "|", end),
        (range(1, length, 2), " ", "a blank"),
        (range(4, length - 1, 4), *between),
        (range(2, length, 4), *inside),
    ]
    padded = line.ljust(length, "\n")
    mistakes = (
        (column, expected)
        for columns, allowed, expected in parts
        for column in columns
        if padded[column] not in allowed
    )
    column, expected = min(mistakes, default=(length, "the end of the line"))
    if column == length:
        column = len(line) - len(line[length:].lstrip(" "))
    there = None if column < len(line) else "the end of the line"
    source.fail(offset + column, f"in a line of {kind}", expected, there)

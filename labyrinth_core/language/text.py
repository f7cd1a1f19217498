"""The text language of labyrinths: `parse` reads it, `dump` writes its canonical form.

Parsing evaluates nothing and takes time at most proportional to the length of the text. See
`docs/language.md` for a tutorial and the whole grammar.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, NoReturn

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.checks import whole
from labyrinth_core.language.source_text import LabyrinthSyntaxError, Source, quoted, read_text
from labyrinth_core.world import (
    SIDES,
    TILES,
    Labyrinth,
    LabyrinthError,
    Look,
    Placer,
    Sketch,
    Structure,
    Task,
    identity,
)

if TYPE_CHECKING:
    from labyrinth_core.world import Labyrinths, Structures

_ALWAYS_WRITTEN = ("key_and_lock", "icy_floor", "occlusion")
"""The settings that every text has; others are written where they are switched on."""

_TASK_OF = {task.rules.setting: task for task in Task if task.rules.setting}

SETTINGS = {name: _TASK_OF[name] for name in _ALWAYS_WRITTEN} | _TASK_OF
"""Setting -> the task that it switches on, in the order in which `dump` writes them."""

SETTINGS_OF = {
    task: "".join(
        f"{name}: {switched_on is task}\n"
        for name, switched_on in SETTINGS.items()
        if switched_on is task or name in _ALWAYS_WRITTEN
    )
    for task in Task
}
"""The settings of each task as text."""

_LETTERS = {tile.name: tile.letter for tile in TILES}
_CELL_LETTERS = ("S", "E", *_LETTERS.values())

_HEADING = "labyrinth"
"""The line that announces the drawing, without its colon."""

_LOOK = "look"
_SETTING = re.compile(r" *([^:]*)(:?) *(.*)")
_FIRST_WORD = re.compile(r" *([^ :]*) *(:?) *")

_LOOKS = tuple(map(str, Look))
_VALUES = dict.fromkeys(SETTINGS, re.compile("true|false")) | {
    _LOOK: re.compile("|".join(_LOOKS)),
}
"""The values that each setting may have, in lower case."""
_EXPECTED = dict.fromkeys(SETTINGS, "True or False") | {
    _LOOK: f"{', '.join(_LOOKS[:-1])} or {_LOOKS[-1]}",
}

_VERTICAL = bytes.maketrans(b"01", b"| ")
_HORIZONTAL = bytes.maketrans(b"01", b"- ")
_OPEN_IN_TEXT = str.maketrans("| -", "010")


def parse(text: str, *, file: str | None = None, seed: int = 0) -> Labyrinth:
    """Return the labyrinth that a text describes.

    text = {setting | look} "labyrinth" ":" drawing "end"

    Args:
        text: The description.
        file: The name of its file, for messages.
        seed: Determines where missing tiles of the task are placed.

    Raises:
        LabyrinthSyntaxError: The text is not in the language, or breaks a rule of its task.
        ValueError: The seed is used and is not a non-negative integer.
    """
    source, settings, drawing = _read(text, file)
    structure, task, look = drawing.structure, settings.task, settings.look
    try:
        start, goal = _ends(source, drawing)
        tiles = _tiles(source, drawing, task)
        singles = {name: tiles[name] for name in task.rules.singles}
        grounds = [tiles[name] for name in task.rules.grounds]
        if None not in singles.values() and (any(grounds) or not grounds):
            return Labyrinth(structure, start, goal, task, look=look, **tiles)
        rng = np.random.default_rng(whole("seed", seed, 0))
        drawn = {name: cell for name, cell in singles.items() if cell is not None}
        return Placer(rng).place(structure, start, goal, task, look=look, **drawn)
    except LabyrinthSyntaxError:  # It knows its place already.
        raise
    except LabyrinthError as error:
        offset = settings.offset if error.cell is None else drawing.offset(error.cell)
        raise source.error(offset, str(error)) from error


def parse_sketch(text: str, *, file: str | None = None) -> Sketch:
    """Return what a text draws, also if it breaks a rule of its task or has no route.

    Raises:
        LabyrinthSyntaxError: The text is not in the language.
    """
    source, settings, drawing = _read(text, file)
    start, goal = _ends(source, drawing)
    tiles = _tiles(source, drawing, settings.task)
    return Sketch(drawing.structure, start, goal, settings.task, look=settings.look, **tiles)


def _read(text: str, file: str | None) -> tuple[Source, _Settings, _Drawing]:
    source = Source(text, file)
    settings = _parse_settings(source)
    drawing = _parse_drawing(source)
    _parse_end(source)
    return source, settings, drawing


class _Settings(NamedTuple):
    """The settings above a drawing."""

    task: Task
    offset: int
    """Offset of the setting that switches the task on, or of the heading if none is on."""
    look: Look


def _parse_settings(source: Source) -> _Settings:
    """Read the settings and the heading above the drawing.

    setting = ("key_and_lock" | "icy_floor" | "occlusion") ":" ("True" | "False")
    look = "look" ":" ("plain" | "recoloured" | "thin_walls")
    """
    switched_on: tuple[Task, int] | None = None
    look = Look.PLAIN
    seen: dict[str, int] = {}
    while True:
        offset, line = source.next_line()
        match = _SETTING.match(line)
        assert match, "every part of the pattern may be empty"
        name, colon, value = match[1].rstrip(" "), match[2], match[3]
        name_at, value_at = offset + match.start(1), offset + match.start(3)
        if name == _HEADING and colon and not value:
            return _Settings(*(switched_on or (Task.NAVIGATION, name_at)), look)
        if name not in _VALUES or not colon:
            _refuse_setting(source, offset, line)
        if name in seen:
            expected = "each setting at most once"
            found = f"{name} again, after line {source.line_number(seen[name])}"
            source.fail(name_at, "a setting is given twice", expected, found)
        seen[name] = name_at
        if not _VALUES[name].fullmatch(value.lower()):
            found = quoted(value) if value else "the end of the line"
            source.fail(value_at, f"in the value of {name}", _EXPECTED[name], found)
        if name == _LOOK:
            look = Look(value.lower())
        elif value.lower() == "true":
            if switched_on:
                found = f"{name}, after line {source.line_number(switched_on[1])}"
                source.fail(name_at, "two tasks are switched on", "one task at most", found)
            switched_on = SETTINGS[name], name_at


def _refuse_setting(source: Source, offset: int, line: str) -> NoReturn:
    """Raise the error for a line before the drawing that is neither setting nor heading."""
    from difflib import get_close_matches

    match = _FIRST_WORD.match(line)
    assert match, "every part of the pattern may be empty"
    word, word_at = match[1], offset + match.start(1)
    if word in (_HEADING, *_VALUES):
        if match[2]:
            message = "the drawing begins on a line of its own"
            source.fail(offset + match.end(), message, "the end of the line")
        source.fail(offset + match.end(), f"after {word}", "':'")
    if not line or line[0] in "-|":
        found = quoted(line.strip(" "))
        source.fail(word_at, "the line before the drawing is missing", f"'{_HEADING}:'", found)
    close = get_close_matches(word[:40].lower(), (_HEADING, *_VALUES), n=1)
    hint = f" (did you mean {close[0]}?)" if close else ""
    expected = f"{', '.join(_VALUES)} or {_HEADING}{hint}"
    source.fail(word_at, "unknown setting", expected, quoted(word or line.strip(" ")))


class _Drawing(NamedTuple):
    """The content of a drawing."""

    structure: Structure
    tiles: str
    """The character in each cell, cell 0 first."""
    rows: list[int]
    """Offset of the line of each row, the lowest row first."""

    def offset(self, cell: int) -> int:
        """Return the offset of a cell."""
        row, column = divmod(cell, self.structure.width)
        return self.rows[row] + 4 * column + 2


def _parse_drawing(source: Source) -> _Drawing:
    """Read the drawing: the structure and the tiles.

    drawing = outer-wall cell-line {wall-line cell-line} outer-wall
    cell-line = "|" cell {("|" | " ") cell} "|"
    cell = " " (" " | "S" | "E" | "K" | "D" | "I") " "
    wall-line = "|" wall {"+" wall} "|"
    wall = " " ("-" | " ") " "
    """
    top = _parse_top(source)
    width = len(top) // 4
    cell = f" [ {re.escape(''.join(_CELL_LETTERS))}] "
    cell_line = re.compile(rf"\|(?:{cell}[| ]){{{width - 1}}}{cell}\|")
    wall_line = re.compile(rf"\|(?: [- ] \+){{{width - 1}}} [- ] \|")
    rows: list[int] = []
    tiles: list[str] = []
    # Bits as text, highest row and last column first, the order in which int() reads them.
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
        if len(rows) == SIDES[-1]:
            source.fail(offset, "the drawing is too tall", f"at most {SIDES[-1]:,} rows", "more")
        up.append(line[-3::-4])
    if len(rows) not in SIDES:
        expected = f"{SIDES[0]} to {SIDES[-1]:,} rows"
        source.fail(offset, "the drawing has too few rows", expected, str(len(rows)))
    bits = (int("".join(lines).translate(_OPEN_IN_TEXT), 2) for lines in (up, right))
    structure = Structure(len(rows), width, *bits)
    return _Drawing(structure, "".join(reversed(tiles)), rows[::-1])


def _parse_top(source: Source) -> str:
    """Read the top line of a drawing, which determines its width.

    outer-wall = "-" {"----"}
    """
    offset, line = source.next_line()
    dashes = len(line) - len(line.lstrip("-"))
    if not line or dashes < len(line):
        expected = "'-'" if dashes else "a line of dashes, the outer wall"
        source.fail(offset + dashes, "in the top line of the drawing", expected)
    width, rest = divmod(dashes - 1, 4)
    if rest or width not in SIDES:
        source.fail(
            offset,
            "the top line of the drawing has the wrong length",
            f"four dashes for each of {SIDES[0]} to {SIDES[-1]:,} columns, and one more",
            f"{dashes:,} dashes",
        )
    return line


def _refuse_line(source: Source, offset: int, line: str, length: int, *, cells: bool) -> NoReturn:
    """Raise the error for a line inside a drawing that is not a valid line of cells or walls."""
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
    inside = ("- ", "'-' or a blank")
    if cells:
        inside = "".join([" ", *_CELL_LETTERS]), f"{', '.join(_CELL_LETTERS)} or a blank"
    parts = [
        (range(1), "|", begin),
        (range(length - 1, length), "|", end),
        (range(1, length, 2), " ", "a blank"),
        (range(4, length - 1, 4), *between),
        (range(2, length, 4), *inside),
    ]
    padded = line.ljust(length, "\n")
    wrong = (
        (column, expected)
        for columns, allowed, expected in parts
        for column in columns
        if padded[column] not in allowed
    )
    column, expected = min(wrong, default=(length, "the end of the line"))
    if column == length:
        column = len(line) - len(line[length:].lstrip(" "))
    past_end = None if column < len(line) else "the end of the line"
    source.fail(offset + column, f"in a line of {kind}", expected, past_end)


def _parse_end(source: Source) -> None:
    """Read `end` and the end of the text."""
    for message, expected in [
        ("the drawing is complete", "end"),
        ("there is text after 'end'", ""),
    ]:
        offset, line = source.next_line()
        text = line.lstrip(" ")
        if text != expected:
            allowed = f"'{expected}'" if expected else "nothing but comments"
            source.fail(offset + len(line) - len(text), message, allowed, quoted(text))


def _ends(source: Source, drawing: _Drawing) -> tuple[int, int]:
    """Return the cells of start and goal, in their default places if they are not drawn."""
    start, goal = drawing.structure.default_ends
    drawn_start, drawn_goal = _only(source, drawing, "S"), _only(source, drawing, "E")
    return (
        start if drawn_start is None else drawn_start,
        goal if drawn_goal is None else drawn_goal,
    )


def _tiles(source: Source, drawing: _Drawing, task: Task) -> dict[str, Any]:
    """Return the cells of the task's tiles as fields of `Labyrinth`; other tiles are ignored."""
    return {
        tile.name: frozenset(at for at, drawn in enumerate(drawing.tiles) if drawn == tile.letter)
        if tile.many
        else _only(source, drawing, tile.letter)
        for tile in task.rules.tiles
    }


def _only(source: Source, drawing: _Drawing, tile: str) -> int | None:
    """Return the cell of a tile that may be drawn once, or None if it is not drawn."""
    tiles = drawing.tiles
    cell = tiles.find(tile)
    if cell >= 0 and tiles.find(tile, cell + 1) >= 0:
        drawn = sorted(drawing.offset(at) for at, found in enumerate(tiles) if found == tile)
        found = f"another, after line {source.line_number(drawn[0])}"
        source.fail(drawn[1], f"{tile} is drawn twice", f"one {tile} at most", found)
    return cell if cell >= 0 else None


def load(path: str | Path, *, seed: int = 0) -> Labyrinth:
    """Return the labyrinth that a UTF-8 file describes.

    Args:
        path: The file.
        seed: Determines where missing tiles of the task are placed.

    Raises:
        LabyrinthSyntaxError: The text is not in the language, or breaks a rule of its task.
        OSError: The file cannot be read.
    """
    return parse(read_text(Path(path)), file=str(path), seed=seed)


def dump(labyrinth: Labyrinth) -> str:
    """Return the canonical text of a labyrinth, which `parse` turns into the same labyrinth."""
    structure = labyrinth.structure
    width, cells = structure.width, structure.cells
    up, right = structure.digits()
    above, beside = up.encode().translate(_HORIZONTAL), right.encode().translate(_VERTICAL)
    tiles = bytearray(b" ") * cells
    tiles[labyrinth.start], tiles[labyrinth.goal] = b"SE"
    if labyrinth.task.rules.tiles:
        for name, cell in labyrinth.tiles():
            tiles[cell] = ord(_LETTERS[name])
    outer_wall = b"-" * (4 * width + 1) + b"\n"
    wall_line = b"|" + b"   +" * (width - 1) + b"   |\n"
    cell_line = b"|" + b"    " * (width - 1) + b"   |\n"
    # Each line of cells below its walls, the first below the outer wall; the outer wall comes last.
    drawing = bytearray(outer_wall + (cell_line + wall_line) * structure.height)
    length = len(outer_wall)
    drawing[-length:] = outer_wall
    for row, first in enumerate(range(cells - width, -1, -width)):
        line, last = (2 * row + 1) * length, first + width
        drawing[line + 2 : line + length : 4] = tiles[first:last]
        # The last cell has no passage, so the outer wall stays.
        drawing[line + 4 : line + length : 4] = beside[first:last]
        if row:
            drawing[line - length + 2 : line : 4] = above[first:last]
    look = "" if labyrinth.look is Look.PLAIN else f"{_LOOK}: {labyrinth.look}\n"
    settings = f"{SETTINGS_OF[labyrinth.task]}{look}"
    return f"{settings}\n{_HEADING}:\n{drawing.decode()}end\n"


def labyrinth_id(labyrinth: Labyrinth | str) -> str:
    """Return the id of a labyrinth: sixteen hexadecimal digits, the same on every machine.

    Args:
        labyrinth: A labyrinth, or its canonical text, as `dump` gives it.
    """
    return identity(labyrinth if isinstance(labyrinth, str) else dump(labyrinth))


# Thousands of canonical texts, of labyrinths of one kind, at once in NumPy.


def parse_many(texts: Sequence[str]) -> Labyrinths | None:
    """Return the labyrinths of one or more texts, the same as `parse` returns.

    Returns:
        None if a text is invalid or not in the canonical form, or if the labyrinths differ in
        size, task or look; parse the texts one by one then.
    """
    from labyrinth_core.world import Labyrinths, Structures  # Import the solver: not for `parse`.

    heads, drawings = zip(*(text.partition("\n\n")[::2] for text in texts), strict=True)
    # Parse one text for each combination of settings.
    parsed = [_canonical(text) for text in dict(zip(heads, texts, strict=True)).values()]
    some = [each for each in parsed if each is not None]
    kinds = {(each.size_name, each.task, each.look) for each in some}
    if len(some) < len(parsed) or len(kinds) > 1:
        return None
    height, width = some[0].structure.height, some[0].structure.width
    pattern = dump(Labyrinth(Structure.without_walls(height, width), 0, height * width - 1))
    pattern = pattern.partition("\n\n")[2]
    joined = "".join(drawings)
    if {len(drawing) for drawing in drawings} != {len(pattern)} or not joined.isascii():
        return None
    shown = np.frombuffer(joined.encode(), np.uint8).reshape(len(texts), -1)
    cells, above, beside = _indices(pattern, height, width)
    fixed = np.ones(len(pattern), np.bool_)
    for free in (cells, above, beside):
        fixed[free] = False
    content, over, right_of = shown[:, cells.ravel()], shown[:, above], shown[:, beside]
    as_drawn = [
        shown[:, fixed] == np.frombuffer(pattern.encode(), np.uint8)[fixed],
        (over == ord(" ")) | (over == ord("-")),
        (right_of == ord(" ")) | (right_of == ord("|")),
    ]
    task = some[0].task
    own = task.rules.tiles
    singles = "SE" + "".join(tile.letter for tile in own if not tile.many)
    letters = np.frombuffer(singles.encode(), np.uint8)
    is_tile = content[:, None] == letters[:, None]
    ground = np.zeros(content.shape, np.uint8)
    for number, letter in enumerate((tile.letter for tile in own if tile.many), start=1):
        ground[content == ord(letter)] = number
    as_drawn += [
        is_tile.sum(axis=2) == 1,
        (content != ord(" ")).sum(axis=1) == len(letters) + (ground > 0).sum(axis=1),
        ground.any(axis=1) == bool(task.rules.grounds),
    ]
    tiles = is_tile.argmax(axis=2)
    if not all(each.all() for each in as_drawn):
        return None
    up = np.zeros((len(texts), height, width), np.bool_)
    right = np.zeros_like(up)
    up[:, :-1], right[:, :, :-1] = over == ord(" "), right_of == ord(" ")
    structures = Structures(height, width, *(each.reshape(len(texts), -1) for each in (up, right)))
    labyrinths = Labyrinths(structures, task, some[0].look, tiles, ground)
    return labyrinths if labyrinths.keep_the_rules() else None


def _canonical(text: str) -> Labyrinth | None:
    """Return the labyrinth of a text, or None if the text is not in the canonical form."""
    try:
        labyrinth = parse(text)
    except LabyrinthSyntaxError:
        return None
    return labyrinth if dump(labyrinth) == text else None


def dump_many(structures: Structures, start: int, goal: int, task: Task) -> list[str]:
    """Return `dump` of each structure with this start, goal and task, which has no tiles."""
    height, width = structures.height, structures.width
    text = dump(Labyrinth(Structure.without_walls(height, width), start, goal, task))
    _, above, beside = _indices(text, height, width)
    up, right = (each.reshape(-1, height, width) for each in (structures.up, structures.right))
    texts = np.tile(np.frombuffer(text.encode(), np.uint8), (len(structures), 1))
    texts[:, above] = np.where(up[:, :-1], ord(" "), ord("-"))
    texts[:, beside] = np.where(right[:, :, :-1], ord(" "), ord("|"))
    joined, length = texts.tobytes().decode(), len(text)
    return [joined[begin : begin + length] for begin in range(0, len(joined), length)]


def _indices(text: str, height: int, width: int) -> list[NDArray[np.int64]]:
    """Return the indices in a canonical text of its cells and passages, the lowest row first.

    Cells have the shape (height, width), passages above them (height - 1, width), and passages on
    their right (height, width - 1).
    """
    indices = np.arange(len(text))[text.index("-----") : text.index("end")]
    indices = indices.reshape(2 * height + 1, 4 * width + 2)[::-1]
    return [indices[1::2, 2::4], indices[2:-1:2, 2::4], indices[1::2, 4:-2:4]]

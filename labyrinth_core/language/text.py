"""The text language of labyrinths: `parse` reads it, `dump` writes its canonical form.

Nothing is evaluated, and the time taken grows with the length of the text and no faster.
`docs/language.md` has a tutorial and the whole grammar.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from labyrinth_core.language.drawn_grid import Drawing, parse_drawing
from labyrinth_core.language.settings import (
    HEADING,
    SETTINGS,
    Settings,
    agent_state,
    agent_text,
    dump_settings,
    parse_settings,
    without_agent,
)
from labyrinth_core.language.source_text import LabyrinthSyntaxError, Source, quoted, read_text
from labyrinth_core.world.grid import digits
from labyrinth_core.world.labyrinth import Labyrinth, LabyrinthError, Task, identity
from labyrinth_core.world.tasks import default_start_and_goal, place

__all__ = [
    "SETTINGS",
    "LabyrinthSyntaxError",
    "agent_text",
    "dump",
    "labyrinth_id",
    "load",
    "parse",
    "without_agent",
]

_VERTICAL = bytes.maketrans(b"01", b"| ")
_HORIZONTAL = bytes.maketrans(b"01", b"- ")


def parse(text: str, *, file: str | None = None, seed: int = 0) -> Labyrinth:
    """Return the labyrinth that a text describes.

    text = {setting | look | agent} "labyrinth" ":" drawing "end"

    Args:
        text: The description.
        file: Name of the file it comes from, for messages.
        seed: Settles where missing tiles of the task are placed.

    Raises:
        LabyrinthSyntaxError: The text is none of the language, or breaks a rule of its task.
    """
    source = Source(text, file)
    settings = parse_settings(source)
    drawing = parse_drawing(source)
    _parse_end(source)
    at_fault = settings.offset
    try:
        labyrinth = _build(source, drawing, settings, seed)
        if settings.agent is None:
            return labyrinth
        value, at_fault = settings.agent
        return replace(labyrinth, agent=agent_state(source, labyrinth, value, at_fault))
    except LabyrinthError as error:
        offset = at_fault if error.cell is None else drawing.offset(error.cell)
        raise source.error(offset, str(error)) from error


def _parse_end(source: Source) -> None:
    """Read on to the end of the text."""
    for message, expected in [
        ("the drawing is complete", "end"),
        ("there is text after 'end'", ""),
    ]:
        offset, line = source.next_line()
        text = line.lstrip(" ")
        if text != expected:
            place = offset + len(line) - len(text)
            wanted = f"'{expected}'" if expected else "nothing but comments"
            source.fail(place, message, wanted, quoted(text))


def _build(source: Source, drawing: Drawing, settings: Settings, seed: int) -> Labyrinth:
    """Return the labyrinth that is drawn, with the tiles that its task lacks."""
    structure, task, look = drawing.structure, settings.task, settings.look
    start, goal = default_start_and_goal(structure.height, structure.width)
    drawn_start, drawn_goal = _only(source, drawing, "S"), _only(source, drawing, "E")
    start = start if drawn_start is None else drawn_start
    goal = goal if drawn_goal is None else drawn_goal
    key = door = None
    ice: frozenset[int] = frozenset()
    complete = True
    if task is Task.KEY_AND_DOOR:
        key, door = _only(source, drawing, "K"), _only(source, drawing, "D")
        complete = None not in (key, door)
    elif task is Task.ICY_FLOOR:
        ice = frozenset(cell for cell, tile in enumerate(drawing.tiles) if tile == "I")
        complete = bool(ice)
    if complete:
        return Labyrinth(structure, start, goal, task, key, door, ice, look)
    rng = np.random.default_rng(seed)
    return replace(place(structure, start, goal, task, rng, key=key, door=door), look=look)


def _only(source: Source, drawing: Drawing, tile: str) -> int | None:
    """Return the cell of a tile that may be drawn once at most, None if it is not drawn."""
    tiles = drawing.tiles
    cell = tiles.find(tile)
    if cell >= 0 and tiles.find(tile, cell + 1) >= 0:
        drawn = sorted(drawing.offset(at) for at, found in enumerate(tiles) if found == tile)
        found = f"another, after line {source.line_number(drawn[0])}"
        source.fail(drawn[1], f"{tile} is drawn twice", f"one {tile} at most", found)
    return cell if cell >= 0 else None


def load(path: Path, *, seed: int = 0) -> Labyrinth:
    """Return the labyrinth that a UTF-8 file describes.

    Args:
        path: The file.
        seed: Settles where missing tiles of the task are placed.

    Raises:
        LabyrinthSyntaxError: Its text is none of the language, or breaks a rule of its task.
        OSError: The file cannot be read.
    """
    return parse(read_text(path), file=str(path), seed=seed)


def dump(labyrinth: Labyrinth) -> str:
    """Return the canonical text of a labyrinth: parsed, it gives the same labyrinth."""
    structure = labyrinth.structure
    width, cells = structure.width, structure.cells
    above = digits(structure.up, cells).encode().translate(_HORIZONTAL)
    beside = digits(structure.right, cells).encode().translate(_VERTICAL)
    tiles = bytearray(b" ") * cells
    tiles[labyrinth.start], tiles[labyrinth.goal] = b"SE"
    if labyrinth.key is not None and labyrinth.door is not None:
        tiles[labyrinth.key], tiles[labyrinth.door] = b"KD"
    for cell in labyrinth.ice:
        tiles[cell] = ord("I")
    shown = bytes(tiles)
    outer_wall = b"-" * (4 * width + 1)
    lines = [outer_wall]
    for first in range(cells - width, -1, -width):
        last = first + width
        if last < cells:
            lines.append(_wall_line(above[first:last]))
        lines.append(_cell_line(shown[first:last], beside[first:last]))
    lines.append(outer_wall)
    drawing = b"\n".join(lines).decode()
    return f"{dump_settings(labyrinth)}\n{HEADING}:\n{drawing}\nend\n"


@lru_cache(maxsize=4_096)
def _cell_line(tiles: bytes, beside: bytes) -> bytes:
    """Return the line of a row of cells, given a character for each and for the wall after it."""
    line = bytearray(b"|   " * len(tiles) + b"|")
    line[2::4] = tiles
    line[4::4] = beside  # The last has no passage: the outer wall.
    return bytes(line)


@lru_cache(maxsize=4_096)
def _wall_line(above: bytes) -> bytes:
    """Return the line above a row of cells, given a character for the wall above each."""
    line = bytearray(b"|   " + b"+   " * (len(above) - 1) + b"|")
    line[2::4] = above
    return bytes(line)


def labyrinth_id(labyrinth: Labyrinth | str) -> str:
    """Return sixteen hexadecimal digits, the same on every machine and in every process.

    They do not depend on where episodes begin.

    Args:
        labyrinth: A labyrinth, or its canonical text, as `dump` gives it.
    """
    return identity(without_agent(labyrinth if isinstance(labyrinth, str) else dump(labyrinth)))

"""Labyrinths on a terminal: drawn in characters and colours, played with the arrow keys."""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Iterable, Iterator, Mapping

from labyrinth_core.dynamics import State, initial, is_terminal, step_limit, transition
from labyrinth_core.grid import Action
from labyrinth_core.labyrinth import Labyrinth
from labyrinth_core.language import dump
from labyrinth_core.visibility import visible_cells

AGENT, HIDDEN, ROUTE = "@", "#", "."
"""What stands for the agent, for cells that it does not see, and for cells on a route."""

COLOURS: Mapping[str, str] = {
    "S": "1;31",
    "E": "1;34",
    "K": "1;33",
    "D": "1;35",
    "I": "1;36",
    AGENT: "1;32",
    ROUTE: "32",
    HIDDEN: "2",
}
"""The colour of each character, as parameters of ECMA-48's SGR sequence."""

RESTART, QUIT = "restart", "quit"
KEYS: Mapping[bytes, Action | str] = {
    **dict.fromkeys([b"\x1b[A", b"\x1bOA", b"w", b"k"], Action.UP),
    **dict.fromkeys([b"\x1b[C", b"\x1bOC", b"d", b"l"], Action.RIGHT),
    **dict.fromkeys([b"\x1b[B", b"\x1bOB", b"s", b"j"], Action.DOWN),
    **dict.fromkeys([b"\x1b[D", b"\x1bOD", b"a", b"h"], Action.LEFT),
    b"r": RESTART,
    b"q": QUIT,
}
"""What the keys of `play` do, by the bytes that a terminal sends for them."""

_FIRST_LINE = 6
"""Line of a dumped text in which the highest row lies, the first being 0."""
_HELP = "arrow keys move, r starts again, q quits"
_SEQUENCE = re.compile(rb"\x1b[\[O][0-9;]*[@-~]|\x1b[\[O]?[0-9;]*\Z|.", re.DOTALL)
_UNFINISHED = re.compile(rb"\x1b[\[O]?[0-9;]{,9}")


def draw(
    labyrinth: Labyrinth,
    state: State | None = None,
    *,
    route: Iterable[int] = (),
    colour: bool = False,
) -> str:
    """Return the text of a labyrinth as people look at it.

    Args:
        labyrinth: What to draw.
        state: Where the agent is, which tiles are left, and what it sees; None for all there is.
        route: Cells to mark, where they are empty.
        colour: Whether the tiles are coloured.
    """
    lines = [list(line) for line in dump(labyrinth).split("\n")]
    structure = labyrinth.structure

    def place(cell: int) -> tuple[list[str], int]:
        row, column = labyrinth.position(cell)
        return lines[_FIRST_LINE + 2 * (structure.height - 1 - row)], 2 + 4 * column

    for cell in route:
        line, at = place(cell)
        if line[at] == " ":
            line[at] = ROUTE
    if state is not None:
        for gone, cell_gone in [(state.has_key, labyrinth.key), (state.door_open, labyrinth.door)]:
            if gone and cell_gone is not None:
                line, at = place(cell_gone)
                line[at] = " "
        line, at = place(state.agent)
        line[at] = AGENT
        _hide(labyrinth, state, lines)
    text = "\n".join("".join(line) for line in lines)
    if not colour:
        return text
    start = text.index("labyrinth:") + len("labyrinth:")

    def paint(match: re.Match[str]) -> str:
        return f"\x1b[{COLOURS[match[0][0]]}m{match[0]}\x1b[0m"

    tiles = "|".join(f"{re.escape(tile)}+" for tile in COLOURS)
    drawing, end = text[start:].rsplit("\nend", 1)
    return f"{text[:start]}{re.sub(tiles, paint, drawing)}\nend{end}"


def _hide(labyrinth: Labyrinth, state: State, lines: list[list[str]]) -> None:
    """Cover the cells that the agent does not see, and the walls with none seen beside them."""
    seen = visible_cells(labyrinth, state.agent)
    if seen is None:
        return
    height, width = labyrinth.structure.height, labyrinth.structure.width
    shown = set()
    for cell in seen:
        row, column = labyrinth.position(cell)
        line, at = _FIRST_LINE + 2 * (height - 1 - row), 2 + 4 * column
        shown |= {(line + down, at + along) for down in (-1, 0, 1) for along in range(-2, 3)}
    for line in range(_FIRST_LINE, _FIRST_LINE + 2 * height - 1):
        for at in range(1, 4 * width):
            if (line, at) not in shown:
                lines[line][at] = HIDDEN


def play(labyrinth: Labyrinth, *, colour: bool) -> None:
    """Let somebody walk through a labyrinth; standard input has to be a terminal.

    Raises:
        OSError: The terminal cannot be used.
    """
    import termios
    import tty

    keyboard = sys.stdin.fileno()
    before = termios.tcgetattr(keyboard)
    try:
        tty.setcbreak(keyboard)
        _walk(labyrinth, pressed(keyboard), colour)
    finally:
        termios.tcsetattr(keyboard, termios.TCSADRAIN, before)


def _walk(labyrinth: Labyrinth, keys: Iterator[Action | str], colour: bool) -> None:
    state, moves, note = initial(labyrinth), 0, _HELP
    while True:
        drawing = draw(labyrinth, state, colour=colour)
        sys.stdout.write(f"\x1b[H\x1b[2J{drawing}\n{moves} moves; {note}\n")
        sys.stdout.flush()
        if is_terminal(labyrinth, state) or moves == step_limit(labyrinth):
            break
        key = next(keys, QUIT)
        if key == QUIT:
            return
        if isinstance(key, Action):
            after = transition(labyrinth, state, key)
            note = "that way is closed" if after.agent == state.agent else _HELP
            state, moves = after, moves + 1
        else:
            state, moves, note = initial(labyrinth), 0, _HELP
    if state.agent == labyrinth.goal:
        ending = "you have reached the goal"
    elif state.agent in labyrinth.ice:
        ending = "the ice broke"
    else:
        ending = "that was the last step allowed"
    sys.stdout.write(f"The episode ends: {ending}.\n")


def pressed(keyboard: int) -> Iterator[Action | str]:
    """Yield what the keys pressed on a terminal (a file descriptor) mean, until its input ends."""
    pending = b""
    while received := os.read(keyboard, 64):
        pending += received
        sequences = _SEQUENCE.findall(pending)
        # An escape sequence may arrive in two parts; whatever is no sequence is forgotten.
        pending = sequences.pop() if _UNFINISHED.fullmatch(sequences[-1]) else b""
        yield from (KEYS[sequence] for sequence in sequences if sequence in KEYS)

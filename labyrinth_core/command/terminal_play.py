"""Labyrinths on a terminal: drawn in characters and colours, played with the arrow keys."""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Iterable, Iterator, Mapping

from labyrinth_core.language.drawing import AGENT, HIDDEN, ROUTE, draw_text
from labyrinth_core.language.text import dump
from labyrinth_core.world.dynamics import State, initial, is_terminal, step_limit, transition
from labyrinth_core.world.grid import Action
from labyrinth_core.world.labyrinth import Labyrinth

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
"""The colour of each character, as parameters of the SGR sequence of ECMA-48."""

RESTART, QUIT = "restart", "quit"
KEYS: Mapping[bytes, Action | str] = {
    **dict.fromkeys([b"\x1b[A", b"\x1bOA", b"w", b"k"], Action.UP),
    **dict.fromkeys([b"\x1b[C", b"\x1bOC", b"d", b"l"], Action.RIGHT),
    **dict.fromkeys([b"\x1b[B", b"\x1bOB", b"s", b"j"], Action.DOWN),
    **dict.fromkeys([b"\x1b[D", b"\x1bOD", b"a", b"h"], Action.LEFT),
    b"r": RESTART,
    b"q": QUIT,
}
"""The meaning of the keys of `play`, by the bytes that a terminal sends for them."""

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
    """Return the drawing of `draw_text` with the settings above it, perhaps in colour."""
    drawing = draw_text(labyrinth, state, route=route)
    if colour:
        tiles = "|".join(f"{re.escape(tile)}+" for tile in COLOURS)
        drawing = re.sub(tiles, lambda run: f"\x1b[{COLOURS[run[0][0]]}m{run[0]}\x1b[0m", drawing)
    settings, _, _ = dump(labyrinth).partition("-")
    return f"{settings}{drawing}end\n"


def play(labyrinth: Labyrinth, *, colour: bool) -> None:
    """Let a person play a labyrinth; standard input must be a terminal.

    Raises:
        OSError: The terminal cannot be used.
    """
    import termios
    import tty

    keyboard = sys.stdin.fileno()
    before = termios.tcgetattr(keyboard)
    try:
        tty.setcbreak(keyboard)
        _play(labyrinth, pressed(keyboard), colour)
    finally:
        termios.tcsetattr(keyboard, termios.TCSADRAIN, before)


def _play(labyrinth: Labyrinth, keys: Iterator[Action | str], colour: bool) -> None:
    state, moves, note = initial(labyrinth), 0, _HELP
    while True:
        drawing = draw(labyrinth, state, colour=colour)
        sys.stdout.write(f"\x1b[H\x1b[2J{drawing}\n{moves} move{'s' * (moves != 1)}; {note}\n")
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
    """Yield the meanings of the keys pressed on a terminal (a file descriptor) until its end."""
    pending = b""
    while received := os.read(keyboard, 64):
        pending += received
        sequences = _SEQUENCE.findall(pending)
        # An escape sequence may arrive in two parts; unknown bytes are ignored.
        pending = sequences.pop() if _UNFINISHED.fullmatch(sequences[-1]) else b""
        yield from (KEYS[sequence] for sequence in sequences if sequence in KEYS)

"""Draw a state as text: the drawing of the language, with the agent in it."""

from __future__ import annotations

from collections.abc import Iterable

from labyrinth_core.language.text import dump
from labyrinth_core.world import Labyrinth, State, Structure

AGENT, HIDDEN, ROUTE = "@", "?", "."


def draw_text(
    labyrinth: Labyrinth, state: State | None = None, *, route: Iterable[int] = ()
) -> str:
    """Return the drawing of a labyrinth, top line first.

    Args:
        labyrinth: What to draw.
        state: The state to draw: the agent is `@`, a key that was picked up or a door that was
            opened is gone, and what the agent cannot see is `?`. None for everything but the agent.
        route: Cells to mark with a dot if they are empty.
    """
    text = dump(labyrinth)
    drawing = list(text[text.index("-----") : text.index("end\n")])
    structure = labyrinth.structure
    for cell in route:
        index = _index(structure, cell)
        drawing[index] = ROUTE if drawing[index] == " " else drawing[index]
    if state is not None:
        if labyrinth.task.rules.hides:
            seen = structure.visible_from(state.agent)
            shown = seen | {labyrinth.start, labyrinth.goal}
            for cell in set(range(structure.cells)) - shown:
                drawing[_index(structure, cell)] = HIDDEN
            for pair in Structure.without_walls(structure.height, structure.width).passages():
                if seen.isdisjoint(pair):  # The wall between two cells out of sight.
                    drawing[sum(_index(structure, cell) for cell in pair) // 2] = HIDDEN
        for tile, gone in ((labyrinth.key, state.has_key), (labyrinth.door, state.door_open)):
            if tile is not None and gone:
                drawing[_index(structure, tile)] = " "
        drawing[_index(structure, state.agent)] = AGENT
    return "".join(drawing)


def describe(labyrinth: Labyrinth, state: State) -> str:
    """Return the agent's observation as text in the language, with the drawing of `draw_text`."""
    text = dump(labyrinth)
    return text[: text.index("-----")] + draw_text(labyrinth, state) + "end\n"


def _index(structure: Structure, cell: int) -> int:
    """Return the index of a cell in the drawing."""
    row, column = divmod(cell, structure.width)
    line, length = 2 * (structure.height - 1 - row) + 1, 4 * structure.width + 2
    return line * length + 4 * column + 2

"""A state as text: the drawing of the language with the agent in it."""

from __future__ import annotations

from collections.abc import Iterable

from labyrinth_core.language.text import dump
from labyrinth_core.world.dynamics import State
from labyrinth_core.world.grid import row_and_column
from labyrinth_core.world.labyrinth import Labyrinth, Task
from labyrinth_core.world.visibility import visible_from

AGENT, HIDDEN, ROUTE = "@", "?", "."


def draw_text(
    labyrinth: Labyrinth, state: State | None = None, *, route: Iterable[int] = ()
) -> str:
    """Return the drawing of a labyrinth, its lines from the top.

    Args:
        labyrinth: What to draw.
        state: Where the agent (`@`) is; a key that was picked up and a door that was opened are
            gone, and what the agent does not see is `?`. None for all there is, and no agent.
        route: Cells to mark with a dot, where they are empty.
    """
    lines = dump(labyrinth).splitlines()
    drawing = [list(line) for line in lines[lines.index("labyrinth:") + 1 : lines.index("end")]]
    for cell in route:
        line, column = _place(labyrinth, cell)
        if drawing[line][column] == " ":
            drawing[line][column] = ROUTE
    if state is None:
        return _joined(drawing)
    if labyrinth.task is Task.PARTIAL_OBSERVABILITY:
        _hide(drawing, labyrinth, visible_from(labyrinth.structure, state.agent))
    if labyrinth.key is not None and labyrinth.door is not None:
        if state.has_key:
            _put(drawing, labyrinth, labyrinth.key, " ")
        if state.door_open:
            _put(drawing, labyrinth, labyrinth.door, " ")
    _put(drawing, labyrinth, state.agent, AGENT)
    return _joined(drawing)


def _joined(drawing: list[list[str]]) -> str:
    return "".join("".join(line) + "\n" for line in drawing)


def _place(labyrinth: Labyrinth, cell: int) -> tuple[int, int]:
    """Return line and column of a cell in the drawing."""
    row, column = row_and_column(cell, labyrinth.structure.width)
    return 2 * (labyrinth.structure.height - 1 - row) + 1, 4 * column + 2


def _put(drawing: list[list[str]], labyrinth: Labyrinth, cell: int, mark: str) -> None:
    line, column = _place(labyrinth, cell)
    drawing[line][column] = mark


def _hide(drawing: list[list[str]], labyrinth: Labyrinth, seen: frozenset[int]) -> None:
    """Cover the cells out of sight, and what lies between two of them; not start and goal."""
    structure = labyrinth.structure
    for cell in set(range(structure.cells)) - seen:
        line, column = _place(labyrinth, cell)
        if cell not in (labyrinth.start, labyrinth.goal):
            drawing[line][column] = HIDDEN
        if (cell + 1) % structure.width and cell + 1 not in seen:
            drawing[line][column + 2] = HIDDEN
        if cell + structure.width < structure.cells and cell + structure.width not in seen:
            drawing[line - 1][column] = HIDDEN

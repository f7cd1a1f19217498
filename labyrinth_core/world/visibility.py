"""What the agent sees under partial observability."""

from __future__ import annotations

from itertools import product

from labyrinth_core.world.grid import Action
from labyrinth_core.world.labyrinth import Structure


def visible_from(structure: Structure, cell: int) -> frozenset[int]:
    """Return the cells seen from `cell`: itself, straight rays and exact diagonals, unbroken.

    A step along a diagonal is unbroken when the passage to the side, and from there the one up
    or down, are both open; to the side first, as in the authors' code.
    """
    moves = structure.moves
    seen = {cell}
    for action in Action:
        at = cell
        while (after := moves[at][action]) != at:
            at = after
            seen.add(at)
    for side, updown in product((Action.RIGHT, Action.LEFT), (Action.UP, Action.DOWN)):
        at = cell
        while (beside := moves[at][side]) != at and (after := moves[beside][updown]) != beside:
            at = after
            seen.add(at)
    return frozenset(seen)

"""What the agent sees under partial observability."""

from __future__ import annotations

from labyrinth_core.world.grid import Action
from labyrinth_core.world.labyrinth import Labyrinth, Structure, Task

_HORIZONTAL = (Action.RIGHT, Action.LEFT)
_VERTICAL = (Action.UP, Action.DOWN)


def visible_from(structure: Structure, cell: int) -> frozenset[int]:
    """Return the cells seen from `cell`: itself, straight rays and exact diagonals, unbroken.

    A step along a diagonal is unbroken when the passage to the side, and from there the one up
    or down, are both open; to the side first, as in the authors' code.
    """
    moves = structure.moves
    seen = {cell}
    rays = [(action,) for action in Action]
    rays += [(side, updown) for side in _HORIZONTAL for updown in _VERTICAL]  # type: ignore[misc]
    for ray in rays:
        at = cell
        while True:
            onward = at
            for action in ray:
                after = moves[onward][action]
                if after == onward:
                    break
                onward = after
            else:
                seen.add(onward)
                at = onward
                continue
            break
    return frozenset(seen)


def visible_cells(labyrinth: Labyrinth, agent: int) -> frozenset[int] | None:
    """Return the cells the agent sees, with start and goal; None where it sees everything."""
    if labyrinth.task is not Task.PARTIAL_OBSERVABILITY:
        return None
    return visible_from(labyrinth.structure, agent) | {labyrinth.start, labyrinth.goal}

"""What the agent sees under partial observability."""

from __future__ import annotations

from itertools import product

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.world.grid import Action
from labyrinth_core.world.labyrinth import Structure

DIAGONALS = tuple(product((Action.RIGHT, Action.LEFT), (Action.UP, Action.DOWN)))
"""The four diagonals: the step to the side, then the one up or down."""


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
    for side, updown in DIAGONALS:
        at = cell
        while (beside := moves[at][side]) != at and (after := moves[beside][updown]) != beside:
            at = after
            seen.add(at)
    return frozenset(seen)


def seen_together(
    moves: NDArray[np.int64], agents: NDArray[np.int64], side: int
) -> NDArray[np.bool_]:
    """Return which of N cells, those of many structures, are seen; as `visible_from` has it.

    Args:
        moves: The cells that the four actions lead to from each cell, shape (N, 4).
        agents: The cell of each agent, one to a structure.
        side: The larger of the structures' height and width.

    Returns:
        Whether an agent sees the cell, shape (N,).
    """
    flat = moves.ravel()
    seen = np.zeros(len(moves), np.bool_)
    seen[agents] = True
    for action in Action:
        at = agents
        for _ in range(side - 1):
            at = flat.take(4 * at + action)  # A wall leads back to a cell that is seen anyway.
            seen[at] = True
    for across, updown in DIAGONALS:
        at = agents
        for _ in range(side - 1):
            beside = flat.take(4 * at + across)
            onward = flat.take(4 * beside + updown)
            at = np.where((beside != at) & (onward != beside), onward, at)
            seen[at] = True
    return seen

"""Structures with long routes: too rare to wait for, so each is made from a sampled one.

A passage is shut and another one opened, wherever that does not shorten the route; and so on, until
the route is long enough. So the structure keeps its number of loops.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import pairwise

import numpy as np

from labyrinth_core.world.grid import neighbours
from labyrinth_core.world.labyrinth import UNREACHABLE, Structure
from labyrinth_core.world.tasks import default_start_and_goal
from pipeline.generation.variants import toggled

_Pair = tuple[int, int]


def stretched(
    structures: Iterator[Structure],
    moves: Callable[[Structure], int],
    accepts: Callable[[Structure], bool],
    longest: int,
    rng: np.random.Generator,
) -> Iterator[Structure]:
    """Yield structures whose shortest routes are longer than a number of moves.

    Args:
        structures: The structures to begin with.
        moves: Returns the moves of the shortest route through a structure, below 0 if it cannot
            hold the task.
        accepts: Returns whether a structure with a route that is long enough will do.
        longest: The number of moves.
        rng: The source of all randomness.

    Yields:
        A structure for each to begin with; one that is no longer where a few exchanges a cell were
        not enough.
    """
    for structure in structures:
        now = moves(structure)
        for _ in range(10 * structure.cells):
            if now > longest and accepts(structure):
                break
            other = _exchanged(structure, rng)
            after = moves(other)
            if after >= min(now, longest + 1):
                structure, now = other, after
        yield structure


def _exchanged(structure: Structure, rng: np.random.Generator) -> Structure:
    """Return a connected structure with one passage shut and another one opened."""
    start, goal = default_start_and_goal(structure.height, structure.width)
    # Half of the time a passage of the way to the goal, where it is most likely to matter.
    to_shut = _way(structure, start, goal) if rng.random() < 0.5 else list(structure.passages())
    cut = toggled(structure, *to_shut[rng.integers(len(to_shut))])
    walls = [pair for pair in _walls(cut) if pair[1] not in structure.moves[pair[0]]]
    reached = cut.distances(start)
    if UNREACHABLE in reached:
        walls = [(a, b) for a, b in walls if (reached[a] < 0) != (reached[b] < 0)]
    return toggled(cut, *walls[rng.integers(len(walls))]) if walls else structure


def _walls(structure: Structure) -> Iterator[_Pair]:
    """Yield the pairs of neighbouring cells without a passage, the lower cell first."""
    height, width = structure.height, structure.width
    for cell, onward in enumerate(structure.moves):
        for beside in neighbours(cell, height, width).values():
            if beside > cell and beside not in onward:
                yield cell, beside


def _way(structure: Structure, start: int, goal: int) -> list[_Pair]:
    """Return the pairs of cells that follow one another on a shortest way, ignoring tiles."""
    to_goal = structure.distances(goal)
    way = [start]
    while way[-1] != goal:
        nearer = to_goal[way[-1]] - 1
        way.append(next(cell for cell in structure.moves[way[-1]] if to_goal[cell] == nearer))
    return list(pairwise(way))

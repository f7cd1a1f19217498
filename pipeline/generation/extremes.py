"""What train has, and the shifts whose labyrinths have more of it, or none."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

from labyrinth_core.world.labyrinth import Labyrinth
from labyrinth_core.world.route_memory import RouteMemory
from labyrinth_core.world.solver import moves_of


class Extremes(NamedTuple):
    """The most that any labyrinth of train has, and the routes in all of them."""

    moves: int = 0
    """Moves of a shortest route."""
    loops: int = 0
    memory: RouteMemory | None = None
    """The demonstrated routes; None if no shift needs them."""

    def with_labyrinth(self, labyrinth: Labyrinth) -> Extremes:
        """Return the extremes with another labyrinth counted in."""
        loops = labyrinth.structure.loops
        return self._replace(
            moves=max(self.moves, moves_of(labyrinth)), loops=max(self.loops, loops)
        )


NO_EXTREMES = Extremes()


def extremes_of(labyrinths: Iterable[Labyrinth]) -> Extremes:
    """Return the most that any of some labyrinths has."""
    extremes = NO_EXTREMES
    for labyrinth in labyrinths:
        extremes = extremes.with_labyrinth(labyrinth)
    return extremes


def shift_problem(split: str, moves: int, loops: int, train: Extremes) -> str | None:
    """Return why a labyrinth has not the property of a shift, None if it has.

    Args:
        split: A shift whose structures are selected.
        moves: The moves of a shortest route through the labyrinth.
        loops: Its loops.
        train: What train has.
    """
    if split == "longer" and moves <= train.moves:
        return f"its shortest route has {moves} moves, and train has one of {train.moves}"
    if split == "trees" and loops:
        return f"it has {loops} loops"
    if split == "open" and loops <= train.loops:
        return f"it has {loops} loops, and train has a labyrinth with {train.loops}"
    return None


def memory_problem(labyrinth: Labyrinth, moves: int, train: Extremes) -> str | None:
    """Return why a labyrinth has not the property of `test_new_routes`, None if it has.

    Args:
        labyrinth: The labyrinth.
        moves: The moves of a shortest route through it.
        train: What train has.
    """
    way = None if train.memory is None else train.memory.best(labyrinth)
    if way is None or len(way) != moves:
        return None
    return "train demonstrates one of its shortest routes"

"""The shifts that select their own structures: how candidates are drawn, and their properties.

`labyrinth_core.data.dataset_config` says what the other shifts change, and `labyrinths` makes their
labyrinths from those of their parent.

Structures with long routes are too rare to wait for, so `stretched` makes each from a sampled
structure. It shuts a passage and opens another one if that does not shorten the route, again and
again, until the route is long enough. So the number of loops stays the same.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from labyrinth_core.data import DatasetConfig, Drawing
from labyrinth_core.world import (
    ALGORITHMS,
    Labyrinth,
    LabyrinthError,
    RouteMemory,
    Solver,
    Structure,
)
from pipeline.generation.labyrinths import toggled, walls


class Train(NamedTuple):
    """The properties of train that labyrinths of some shifts must exceed, or must not share."""

    moves: int = 0
    """The largest number of moves of a shortest route."""
    loops: int = 0
    """The largest number of loops of a labyrinth."""
    memory: RouteMemory | None = None
    """The demonstrated routes; None if no shift needs them."""


class Measures(NamedTuple):
    """The measures by which structures are selected."""

    moves: int
    """The number of moves of a shortest route."""
    loops: int
    junctions: int
    """The number of cells where ways part."""


Problem = Callable[[Measures, Callable[[], Labyrinth], Train], str | None]


@dataclass(frozen=True)
class SelectedShift:
    """A shift with its own structures, selected to be similar to those of test.

    Candidates are drawn like the structures of train, except as the fields say.
    """

    free: tuple[str, ...]
    """The measures that the shift does not change, in which structures are matched to test."""
    problem: Problem = lambda _measures, _labyrinth, _train: None
    """Returns why a labyrinth lacks the property of the shift, None if it has the property.

    The arguments are the measures, a slow function that makes the labyrinth, and the properties of
    train."""
    sampler: str | None = None
    open_walls: Callable[[DatasetConfig, Train], float] = lambda config, _train: config.open_walls
    pool: int = 96
    """The number of candidates to choose from."""
    renewed: int = 6
    """The number of them that are new for each choice."""
    patience: int = 30_000
    """The number of unsuitable structures in a row after which the search ends."""
    is_stretched: bool = False
    """Whether candidates are changed until their route is longer than the longest of train."""
    needs_routes: bool = False
    """Whether the shift needs the routes that train demonstrates."""

    def draw(
        self, config: DatasetConfig, split: str, train: Train, rng: np.random.Generator
    ) -> Iterator[Structure]:
        """Yield random structures, most of them with the property of the shift."""

        def in_bucket(structure: Structure) -> bool:
            return config.bucket_of(structure) == "test"

        def moves(structure: Structure) -> int:
            measures = measures_of(config, split, structure)
            return -1 if measures is None else measures.moves

        drawn = Structure.sample(
            config.height,
            config.width,
            rng,
            algorithm=self.sampler or config.sampler,
            open_walls=self.open_walls(config, train),
        )
        if self.is_stretched:
            return stretched(drawn, moves, in_bucket, train.moves, rng)
        # Comparing routes is slow, so the bucket is checked first.
        return filter(in_bucket, drawn) if self.needs_routes else drawn


def measures_of(config: DatasetConfig, split: str, structure: Structure) -> Measures | None:
    """Return the measures of a structure in a split, None if it cannot hold the task."""
    if not config.task.rules.tiles and config.goals == "fixed":
        # Making the labyrinth takes 7 times as long at 5x5.
        moves = structure.least_moves(*structure.default_ends)
    else:
        try:
            moves = Solver(Drawing(config).labyrinth(split, structure)).moves
        except LabyrinthError:
            return None
    return Measures(moves, structure.loops, structure.junctions)


def _many_open_walls(config: DatasetConfig, train: Train) -> float:
    """Return the probability of opening walls that gives about twice the loops of train's most.

    At most, it gives the mean of that number and of the most loops that the size allows.
    """
    most = Structure.without_walls(config.height, config.width).loops
    return min(2 * train.loops + 1, (train.loops + most) / 2) / most


def _not_longer(measures: Measures, _labyrinth: object, train: Train) -> str | None:
    if measures.moves > train.moves:
        return None
    return f"its shortest route has {measures.moves} moves, and train has one of {train.moves}"


def _has_loops(measures: Measures, _labyrinth: object, _train: Train) -> str | None:
    return f"it has {measures.loops} loops" if measures.loops else None


def _not_more_open(measures: Measures, _labyrinth: object, train: Train) -> str | None:
    if measures.loops > train.loops:
        return None
    return f"it has {measures.loops} loops, and train has a labyrinth with {train.loops}"


def _known_route(
    measures: Measures, labyrinth: Callable[[], Labyrinth], train: Train
) -> str | None:
    way = None if train.memory is None else train.memory.best(labyrinth())
    if way is None or len(way) != measures.moves:
        return None
    return "train demonstrates one of its shortest routes"


SELECTED_SHIFTS = {
    "longer": SelectedShift(
        ("loops", "junctions"),
        _not_longer,
        pool=8,
        renewed=1,
        patience=200,
        is_stretched=True,
    ),
    "trees": SelectedShift(
        ("moves", "junctions"), _has_loops, open_walls=lambda _config, _train: 0.0
    ),
    "open": SelectedShift(("moves",), _not_more_open, open_walls=_many_open_walls),
    **{name: SelectedShift(("moves", "loops"), sampler=name) for name in ALGORITHMS},
    "test_new_routes": SelectedShift(
        Measures._fields,
        _known_route,
        renewed=2,
        patience=1_000,
        needs_routes=True,
    ),
}
"""Shift -> how its structures are selected."""


def train_of(
    config: DatasetConfig, demonstrated: Iterable[tuple[Labyrinth, Iterable[Iterable[int]]]]
) -> Train:
    """Return the properties of train that the shifts of a dataset need.

    Args:
        config: The configuration of the dataset.
        demonstrated: Each labyrinth of train, with the cells of each route through it; the routes
            are only iterated over if a shift needs them.
    """
    needs_routes = any(SELECTED_SHIFTS[each].needs_routes for each in selected_shifts(config))
    moves, loops, routes = 0, 0, list[Iterable[int]]()
    for labyrinth, its_routes in demonstrated:
        moves = max(moves, Solver(labyrinth).moves)
        loops = max(loops, labyrinth.structure.loops)
        if needs_routes:
            routes += its_routes
    return Train(moves, loops, RouteMemory(routes) if needs_routes else None)


def selected_shifts(config: DatasetConfig) -> list[str]:
    """Return the shifts of a dataset that have structures of their own."""
    return [shift for shift in config.shifts if shift in SELECTED_SHIFTS]


def stretched(
    structures: Iterator[Structure],
    moves: Callable[[Structure], int],
    accepts: Callable[[Structure], bool],
    longest: int,
    rng: np.random.Generator,
) -> Iterator[Structure]:
    """Yield structures whose shortest routes have more than `longest` moves.

    Args:
        structures: The structures to begin with.
        moves: Returns the moves of the shortest route through a structure, below 0 if it cannot
            hold the task.
        accepts: Returns whether a structure with a route that is long enough is acceptable.
        longest: The number of moves to exceed.
        rng: The source of all randomness.

    Yields:
        One structure for each of `structures`. After ten exchanges per cell it is yielded even if
        its route is too short.
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
    start, goal = structure.default_ends
    # Half of the time, shut a passage on the way to the goal: it is most likely to matter.
    to_shut = _way(structure, start, goal) if rng.random() < 0.5 else list(structure.passages())
    cut = toggled(structure, *to_shut[rng.integers(len(to_shut))])
    closed = list(walls(structure))
    reached = cut.distances(start)
    if min(reached) < 0:  # Shutting it has split the grid: open a wall between the two parts.
        closed = [(a, b) for a, b in closed if (reached[a] < 0) != (reached[b] < 0)]
    return toggled(cut, *closed[rng.integers(len(closed))]) if closed else structure


def _way(structure: Structure, start: int, goal: int) -> list[tuple[int, int]]:
    """Return the pairs of consecutive cells on a shortest way, ignoring tiles."""
    to_goal = structure.distances(goal)
    way = [start]
    while way[-1] != goal:
        nearer = to_goal[way[-1]] - 1
        way.append(next(cell for cell in structure.moves[way[-1]] if to_goal[cell] == nearer))
    return list(pairwise(way))

"""The shifts whose structures are selected: how candidates are drawn, and what must hold of them.

What the other shifts change is in `labyrinth_core.data.splits`, and `variants` makes their
labyrinths from those of their parent.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from labyrinth_core.data.buckets import bucket_of
from labyrinth_core.data.dataset_config import DatasetConfig
from labyrinth_core.world.grid import horizontal_edges, vertical_edges
from labyrinth_core.world.labyrinth import Labyrinth, LabyrinthError, Structure
from labyrinth_core.world.route_memory import RouteMemory
from labyrinth_core.world.sampling import ALGORITHMS, sample_structures
from labyrinth_core.world.solver import moves_of
from pipeline.generation.detours import stretched
from pipeline.generation.variants import TASKS_WITHOUT_TILES, labyrinth_of, start_and_goal


class Train(NamedTuple):
    """What train has, and the labyrinths of some shifts have more of, or none."""

    moves: int = 0
    """The moves of the longest of its shortest routes."""
    loops: int = 0
    """The most loops that any of its labyrinths has."""
    memory: RouteMemory | None = None
    """The demonstrated routes; None if no shift needs them."""

    def with_labyrinth(self, labyrinth: Labyrinth) -> Train:
        """Return what train has with another labyrinth."""
        moves, loops = moves_of(labyrinth), labyrinth.structure.loops
        return self._replace(moves=max(self.moves, moves), loops=max(self.loops, loops))


class Measures(NamedTuple):
    """What a structure is selected by."""

    moves: int
    """The moves of a shortest route."""
    loops: int
    junctions: int
    """The cells where ways part."""


class Effort(NamedTuple):
    """The number of candidates that a choice is made from."""

    pool: int = 96
    """The number of candidates to choose from."""
    renewed: int = 6
    """How many of them are new for each choice."""
    patience: int = 30_000
    """The number of structures without one that will do, after which the search ends."""


Problem = Callable[[Measures, Callable[[], Labyrinth], Train], str | None]


@dataclass(frozen=True)
class SelectedShift:
    """A shift with structures of its own, which are selected to be like those of test.

    Candidates are drawn as the structures of train are, but for what the fields say.
    """

    free: tuple[str, ...]
    """The measures that the shift leaves free, and that follow those of test."""
    problem: Problem = lambda _measures, _labyrinth, _train: None
    """Returns why a labyrinth lacks the property of the shift, None if it has it.

    Its arguments are the measures, a function that makes the labyrinth, which takes long, and what
    train has."""
    sampler: str | None = None
    open_walls: Callable[[DatasetConfig, Train], float] = lambda config, _train: config.open_walls
    effort: Effort = Effort()  # noqa: RUF009
    is_stretched: bool = False
    """Whether candidates are changed until they are longer than the longest of train."""
    needs_routes: bool = False
    """Whether the routes that train demonstrates have to be known."""

    def draw(
        self, config: DatasetConfig, split: str, train: Train, rng: np.random.Generator
    ) -> Iterator[Structure]:
        """Yield random structures, most of them with the property of the shift."""

        def in_bucket(structure: Structure) -> bool:
            return bucket_of(config, structure) == "test"

        def moves(structure: Structure) -> int:
            measures = measures_of(config, split, structure)
            return -1 if measures is None else measures.moves

        drawn = sample_structures(
            config.height,
            config.width,
            rng,
            algorithm=self.sampler or config.sampler,
            open_walls=self.open_walls(config, train),
        )
        if self.is_stretched:
            return stretched(drawn, moves, in_bucket, train.moves, rng)
        # It takes so long to compare routes that it is worth while to ask for the bucket first.
        return filter(in_bucket, drawn) if self.needs_routes else drawn


def measures_of(config: DatasetConfig, split: str, structure: Structure) -> Measures | None:
    """Return the measures of a structure in a split, None if it cannot hold the task."""
    if config.task in TASKS_WITHOUT_TILES:  # A labyrinth would take seven times as long at 5x5.
        moves = structure.least_moves(*start_and_goal(config, split, structure))
    else:
        try:
            moves = moves_of(labyrinth_of(config, split, structure))
        except LabyrinthError:
            return None
    return Measures(moves, structure.loops, structure.junctions)


def _many_open_walls(config: DatasetConfig, train: Train) -> float:
    """Return the probability of opening walls that gives about twice train's most loops.

    Where there are not so many walls, it gives the mean of train's most and of all.
    """
    height, width = config.height, config.width
    edges = vertical_edges(height, width) | horizontal_edges(height, width) << height * width
    walls = edges.bit_count() - height * width + 1
    return min(2 * train.loops + 1, (train.loops + walls) / 2) / walls


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
        effort=Effort(pool=8, renewed=1, patience=200),
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
        effort=Effort(renewed=2, patience=1_000),
        needs_routes=True,
    ),
}
"""Shift -> how its structures are selected."""

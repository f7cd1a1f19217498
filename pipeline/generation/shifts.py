"""The shifts whose structures are selected: how candidates are drawn, and what must hold of them.

What the other shifts change is in `labyrinth_core.data.splits`, and `variants` makes their
labyrinths from those of their parent.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from labyrinth_core.data.dataset_config import DatasetConfig
from labyrinth_core.world.grid import horizontal_edges, vertical_edges
from labyrinth_core.world.labyrinth import Labyrinth, LabyrinthError, Structure
from labyrinth_core.world.route_memory import RouteMemory
from labyrinth_core.world.sampling import ALGORITHMS, sample_structures
from labyrinth_core.world.solver import moves_of
from pipeline.generation.detours import stretched
from pipeline.generation.identity import bucket_of
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


USUAL_EFFORT = Effort()

Draw = Callable[[DatasetConfig, str, Train, np.random.Generator], Iterator[Structure]]
Problem = Callable[[Measures, Callable[[], Labyrinth], Train], str | None]


def sampled_like_train(
    config: DatasetConfig, _split: str, _train: Train, rng: np.random.Generator
) -> Iterator[Structure]:
    """Yield structures as train has them."""
    return _sampled(config, rng, config.sampler, config.open_walls)


def no_problem(
    _measures: Measures, _labyrinth: Callable[[], Labyrinth], _train: Train
) -> str | None:
    """Return None: how its structures are drawn is all that makes the shift."""
    return None


@dataclass(frozen=True)
class SelectedShift:
    """A shift with structures of its own, which are selected to be like those of test."""

    free: tuple[str, ...]
    """The measures that the shift leaves free, and that follow those of test."""
    draw: Draw = sampled_like_train
    """Yields random structures, most of them with the property of the shift.

    Its arguments are the configuration, the name of the shift, what train has, and the source of
    randomness."""
    problem: Problem = no_problem
    """Returns why a labyrinth lacks the property of the shift, None if it has it.

    Its arguments are the measures, a function that makes the labyrinth, which takes long, and what
    train has."""
    effort: Effort = USUAL_EFFORT
    needs_routes: bool = False
    """Whether the routes that train demonstrates have to be known."""


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


def _sampled(
    config: DatasetConfig, rng: np.random.Generator, sampler: str, open_walls: float
) -> Iterator[Structure]:
    size = config.height, config.width
    return sample_structures(*size, rng, algorithm=sampler, open_walls=open_walls)


def _draw_longer(
    config: DatasetConfig, split: str, train: Train, rng: np.random.Generator
) -> Iterator[Structure]:
    def moves(structure: Structure) -> int:
        measures = measures_of(config, split, structure)
        return -1 if measures is None else measures.moves

    def accepts(structure: Structure) -> bool:
        return bucket_of(config, structure) == "test"

    drawn = sampled_like_train(config, split, train, rng)
    return stretched(drawn, moves, accepts, train.moves, rng)


def _draw_open(
    config: DatasetConfig, _split: str, train: Train, rng: np.random.Generator
) -> Iterator[Structure]:
    """Yield structures with about twice the most loops of train.

    Where there are not so many walls, it is the mean of train's most and of all.
    """
    height, width = config.height, config.width
    edges = vertical_edges(height, width) | horizontal_edges(height, width) << height * width
    walls = edges.bit_count() - height * width + 1
    opened = min(2 * train.loops + 1, (train.loops + walls) / 2) / walls
    return _sampled(config, rng, config.sampler, opened)


def _draw_new_routes(
    config: DatasetConfig, split: str, train: Train, rng: np.random.Generator
) -> Iterator[Structure]:
    """Yield structures of test; most are refused, so that it is worth while to ask first."""
    drawn = sampled_like_train(config, split, train, rng)
    return (structure for structure in drawn if bucket_of(config, structure) == "test")


def _not_longer(
    measures: Measures, _labyrinth: Callable[[], Labyrinth], train: Train
) -> str | None:
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


def _sampled_by(sampler: str) -> SelectedShift:
    return SelectedShift(
        ("moves", "loops"),
        lambda config, _split, _train, rng: _sampled(config, rng, sampler, config.open_walls),
    )


SELECTED_SHIFTS = {
    "longer": SelectedShift(
        ("loops", "junctions"), _draw_longer, _not_longer, Effort(pool=8, renewed=1, patience=200)
    ),
    "trees": SelectedShift(
        ("moves", "junctions"),
        lambda config, _split, _train, rng: _sampled(config, rng, config.sampler, 0.0),
        _has_loops,
    ),
    "open": SelectedShift(("moves",), _draw_open, _not_more_open),
    **{sampler: _sampled_by(sampler) for sampler in ALGORITHMS},
    "test_new_routes": SelectedShift(
        Measures._fields,
        _draw_new_routes,
        _known_route,
        Effort(renewed=2, patience=1_000),
        needs_routes=True,
    ),
}
"""Shift -> how its structures are selected."""

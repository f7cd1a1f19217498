"""The shifts that select their own structures: the candidates' properties, and the selection.

`labyrinth_core.data.dataset_config` says what the other shifts change, and `labyrinths` makes their
labyrinths from those of their parent.

Structures with long routes are too rare to wait for, so `stretched` makes each from a sampled
structure. It shuts a passage and opens another one if that does not shorten the route, again and
again, until the route is long enough. So the number of loops stays the same.

Such a shift matches test in the measures that the shift does not change. For each labyrinth of test
in turn, it takes the candidate nearest in these measures, from a pool that is constantly renewed.
Each structure taken is in the bucket of test, so no dataset trains on it, and no other split has
it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import chain, islice, pairwise
from typing import NamedTuple

import numpy as np

from labyrinth_core.data import SPLITS, DatasetConfig, Drawing
from labyrinth_core.world import (
    ALGORITHMS,
    Labyrinth,
    LabyrinthError,
    RouteMemory,
    Solver,
    Structure,
)
from pipeline.config import ConfigError
from pipeline.generation.labyrinths import UNFIT, Records, pack, toggled, unpack, walls
from pipeline.inspection import Neighbourhood
from pipeline.machinery import tracked


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


class Candidate(NamedTuple):
    """A structure that may be selected, with the measures that are matched to test."""

    measures: tuple[int, ...]
    structure: Structure


def selected(config: DatasetConfig, sampled: Mapping[str, Records]) -> dict[str, Records]:
    """Return the structures of each shift that selects its own.

    Args:
        config: The configuration of the dataset.
        sampled: The structures of train, validation and test.

    Raises:
        ConfigError: A shift finds too few structures.
    """
    structures = unpack(config, sampled["train"])
    drawing = Drawing(config)

    def routes(labyrinth: Labyrinth) -> Iterator[list[int]]:
        """Yield the cells of each route that train demonstrates in a labyrinth."""
        for episode in drawing.episodes("train", labyrinth):
            yield [state.agent for state in episode.states]

    labyrinths = (drawing.labyrinth("train", structure) for structure in structures)
    train = train_of(config, ((each, routes(each)) for each in labyrinths))
    taken = Taken(config, sampled)
    measured = (measures_of(config, "test", each) for each in unpack(config, sampled["test"]))
    targets = [measures for measures in measured if measures is not None]  # Test holds the task.

    def of(split: str) -> Iterator[tuple[Structure, int]]:
        picked = select(config, split, train, targets, taken)
        return ((each, UNFIT) for each in tracked(picked, split, config.labyrinths))

    return {split: pack(config, of(split)) for split in selected_shifts(config)}


class Taken:
    """The structures that shifts may not select: those that a split has, or that are near them."""

    def __init__(self, config: DatasetConfig, sampled: Mapping[str, Records]) -> None:
        self._config = config
        # Shifts never select from the buckets of the other splits.
        self._ids: set[int] = set(sampled["test"]["id"].tolist())
        self._near: Neighbourhood | None = None
        if config.min_walls > 1:
            size = config.height, config.width
            self._near = Neighbourhood(*size, config.min_walls - 1, 3 * config.labyrinths)
            for structure in chain.from_iterable(unpack(config, of) for of in sampled.values()):
                self._near.add(structure)

    def take(self, structure: Structure) -> bool:
        """Take a structure for a shift; return whether it was free."""
        if self._config.bucket_of(structure) != "test":
            return False
        if self._near is not None and self._near.is_near(structure):
            return False
        number = int(structure.structure_id, 16)
        is_free = number not in self._ids
        self._ids.add(number)
        return is_free


def select(
    config: DatasetConfig, split: str, train: Train, targets: Sequence[Measures], taken: Taken
) -> Iterator[Structure]:
    """Yield the structures of a shift, one for each labyrinth of test.

    Args:
        config: The configuration of the dataset.
        split: The shift.
        train: The properties of train.
        targets: The measures of each labyrinth of test.
        taken: The structures that may not be selected; this is updated.

    Raises:
        ConfigError: The search finds too few structures.
    """
    shift = SELECTED_SHIFTS[split]
    candidates = _candidates(config, split, train)
    pool = list(islice(candidates, shift.pool))
    for number, measures in enumerate(targets):
        pool += islice(candidates, shift.renewed)
        del pool[: -shift.pool]
        chosen = _nearest(pool, _free(split, measures), taken)
        if chosen is None:
            pool.clear()
            more = (each.structure for each in islice(candidates, shift.patience))
            chosen = next(filter(taken.take, more), None)
        if chosen is None:
            raise ConfigError(
                f"shifts: {number} of labyrinths={config.labyrinths} were found for {split} at "
                f"{config.name}, and no other after a long search; ask for fewer labyrinths, or "
                f"leave {split} out"
            )
        yield chosen


def _nearest(pool: list[Candidate], target: tuple[int, ...], taken: Taken) -> Structure | None:
    """Take the free candidate nearest to a target out of a pool; return None if none is free.

    Nearer candidates that are not free leave the pool as well.
    """

    def apart(measures: tuple[int, ...]) -> int:
        return sum(abs(a - b) for a, b in zip(measures, target, strict=True))

    distances = {key: apart(key) for key in {each.measures for each in pool}}
    nearest_first = sorted(range(len(pool)), key=lambda index: distances[pool[index].measures])
    for tried, index in enumerate(nearest_first, start=1):
        structure = pool[index].structure
        if taken.take(structure):
            for gone in sorted(nearest_first[:tried], reverse=True):
                del pool[gone]
            return structure
    return None


def _candidates(config: DatasetConfig, split: str, train: Train) -> Iterator[Candidate]:
    """Yield structures with the property of a shift, until there seem to be no more."""
    shift = SELECTED_SHIFTS[split]
    seed = np.random.SeedSequence(config.seed, spawn_key=(SPLITS[split].number,))
    without = 0
    for structure in shift.draw(config, split, train, np.random.default_rng(seed)):
        without += 1
        if without > shift.patience:
            return
        measures = measures_of(config, split, structure)
        labyrinth = partial(Drawing(config).labyrinth, split, structure)
        if measures is not None and shift.problem(measures, labyrinth, train) is None:
            without = 0
            yield Candidate(_free(split, measures), structure)


def _free(split: str, measures: Measures) -> tuple[int, ...]:
    return tuple(getattr(measures, name) for name in SELECTED_SHIFTS[split].free)

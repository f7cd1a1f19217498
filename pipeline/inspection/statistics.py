"""Counts of a dataset's rows, from its episodes read without their pictures.

The counts are sums over each split, and numbers for each labyrinth. One pass over a shard computes
all of them, with the labyrinths of one shard in memory. The certificate of disjointness follows
from the same pass.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import partial
from itertools import chain
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.data import Dataset, DatasetConfig, Manifest, Shard, ShardFile
from labyrinth_core.errors import DatasetError, one_line
from labyrinth_core.language import parse
from labyrinth_core.storage import AnyPath
from labyrinth_core.world import Action, Labyrinth, LabyrinthError, Solver
from pipeline.inspection.leakage import Certificate, Keys, certify
from pipeline.machinery import ordered_map, tracked


class Route(NamedTuple):
    """The route of one episode."""

    labyrinth: Labyrinth
    is_first: bool
    """Whether it is the labyrinth's first route."""
    solver: Solver
    """The labyrinth, solved."""
    states: Sequence[int]
    """The T + 1 states visited, as `Labyrinth` numbers them: modulo the cells, the agent's cell."""
    actions: Sequence[int]
    """The T actions taken."""
    returned: float
    """The sum of the episode's rewards."""


def routes_of(file: ShardFile) -> Iterator[Route]:
    """Yield the routes of a shard, grouped by labyrinth, reading one row group at a time.

    Raises:
        DatasetError: The file is missing or damaged, or its rows do not form episodes; a text does
            not describe a labyrinth, or an action is not one of the four.
    """
    before: str | None = None
    try:
        for text, actions, returned in (each for group in file.episodes() for each in group.each()):
            is_first = text != before
            if is_first:
                before, labyrinth = text, parse(text)
                solver = Solver(labyrinth)
            for action in (min(actions, default=0), max(actions, default=0)):
                if not 0 <= action < len(Action):
                    raise DatasetError(f"{action} is not an action")
            states = [labyrinth.start]
            for action in actions:
                states.append(solver.table[states[-1]][action])
            yield Route(labyrinth, is_first, solver, states, actions, returned)
    except (DatasetError, LabyrinthError) as error:
        if isinstance(error, DatasetError) and str(file.path) in str(error):  # From the file.
            raise
        raise DatasetError(f"{file.path} cannot be read: {one_line(error)}") from error


class Example(NamedTuple):
    """A labyrinth of a split with its first episode."""

    labyrinth: Labyrinth
    actions: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class SplitCounts:
    """The counts of a split or of a shard."""

    actions: NDArray[np.int64]
    """How often each action is taken, shape (4,)."""
    visits: NDArray[np.int64]
    """Rows with the agent in each cell, shape (height, width), row 0 at the bottom."""
    labyrinths: int
    lengths: Counter[int]
    """Number of moves -> number of episodes."""
    moves: Counter[int]
    """Number of moves of a shortest route -> number of labyrinths."""
    loops: Counter[int]
    """Passages beyond those of a tree (passages - cells + 1) -> number of labyrinths."""
    junctions: Counter[int]
    """Number of cells with three or four passages -> number of labyrinths."""
    returned: float
    """The sum of all rewards."""
    choices: int
    """The number of optimal actions, summed over the states in which an action is taken."""
    optimal: int
    """The number of actions taken that are optimal."""
    examples: list[Example]
    """The first `EXAMPLES` labyrinths, for pictures."""
    EXAMPLES: ClassVar[int] = 5

    @property
    def episodes(self) -> int:
        """The number of episodes."""
        return self.lengths.total()

    @property
    def rows(self) -> int:
        """The number of rows, one for each state of an episode."""
        return int(self.visits.sum())

    @property
    def longest(self) -> int:
        """The number of moves of the longest episode."""
        return max(self.lengths)

    @property
    def mean_moves(self) -> float:
        """The mean number of moves of an episode."""
        return int(self.actions.sum()) / self.episodes

    @property
    def mean_return(self) -> float:
        """The mean return of an episode."""
        return self.returned / self.episodes

    @property
    def mean_loops(self) -> float:
        """The mean number of loops of a labyrinth."""
        return sum(loops * count for loops, count in self.loops.items()) / self.labyrinths

    @property
    def mean_choices(self) -> float:
        """The mean number of optimal actions per state in which an action is taken."""
        return self.choices / int(self.actions.sum())

    @property
    def optimal_share(self) -> float:
        """The share of the actions that are optimal."""
        return self.optimal / int(self.actions.sum())

    @property
    def action_shares(self) -> NDArray[np.float64]:
        """The share of each action, shape (4,)."""
        shares: NDArray[np.float64] = self.actions / self.actions.sum()
        return shares

    def __add__(self, other: SplitCounts) -> SplitCounts:
        """Return the counts of this part of a split and the next part together."""
        names = [each.name for each in fields(self)]
        both = SplitCounts(**{name: getattr(self, name) + getattr(other, name) for name in names})
        return replace(both, examples=both.examples[: self.EXAMPLES])


@dataclass(frozen=True, eq=False)
class Content:
    """The labyrinths of a split, in order, each with counts over all its episodes."""

    labyrinths: tuple[Labyrinth, ...]
    moves: NDArray[np.int64]
    """The number of moves of a shortest route, shape (labyrinths,)."""
    actions: NDArray[np.int64]
    """How often each action is taken, shape (labyrinths, 4)."""
    visits: NDArray[np.int64]
    """States with the agent in each cell, shape (labyrinths, height, width)."""

    @classmethod
    def joined(cls, parts: Sequence[Content]) -> Content:
        """Return the content of consecutive shards."""
        labyrinths, *arrays = zip(*(vars(part).values() for part in parts), strict=True)
        return cls(tuple(chain.from_iterable(labyrinths)), *map(np.concatenate, arrays))


class Counted(NamedTuple):
    """The results of one pass over a shard."""

    counts: SplitCounts
    keys: Keys
    content: Content


def count_routes(routes: Iterable[Route], size: tuple[int, int]) -> Counted:
    """Return the counts of episodes.

    Args:
        routes: The routes of the episodes, grouped by labyrinth.
        size: The height and the width of all their labyrinths.
    """
    labyrinths: list[Labyrinth] = []
    examples: list[Example] = []
    moves, actions, visits = [], [], []
    lengths: Counter[int] = Counter()
    returned, choices, optimal = 0.0, 0, 0
    cells = size[0] * size[1]
    for route in routes:
        if route.is_first:
            labyrinths.append(route.labyrinth)
            moves.append(route.solver.moves)
            actions.append(np.zeros(len(Action), np.int64))
            visits.append(np.zeros(cells, np.int64))
            best = route.solver.optimal_actions()
            if len(examples) < SplitCounts.EXAMPLES:
                examples.append(Example(route.labyrinth, tuple(route.actions)))
        taken = np.array(route.actions, np.int64)
        states = np.array(route.states)
        actions[-1] += np.bincount(taken, minlength=len(Action))
        visits[-1] += np.bincount(states % cells, minlength=cells)
        choices += int(best[states[:-1]].sum())
        optimal += int(best[states[:-1], taken].sum())
        lengths[len(taken)] += 1
        returned += route.returned
    content = Content(
        tuple(labyrinths),
        np.array(moves, np.int64),
        np.array(actions, np.int64).reshape(-1, len(Action)),
        np.array(visits, np.int64).reshape(-1, *size),
    )
    counts = SplitCounts(
        actions=content.actions.sum(axis=0),
        visits=content.visits.sum(axis=0),
        labyrinths=len(labyrinths),
        lengths=lengths,
        moves=Counter(moves),
        loops=Counter(each.structure.loops for each in labyrinths),
        junctions=Counter(each.structure.junctions for each in labyrinths),
        returned=returned,
        choices=choices,
        optimal=optimal,
        examples=examples,
    )
    return Counted(counts, Keys.of(labyrinths), content)


def _of_size(size: tuple[int, int], routes: Iterable[Route], path: AnyPath) -> Iterator[Route]:
    """Yield routes; raise DatasetError if one is in a labyrinth that does not have the size."""
    expected = f"{size[0]}x{size[1]}"
    for route in routes:
        if (held := route.labyrinth.size_name) != expected:
            raise DatasetError(f"{path} cannot be read: a labyrinth is {held}, not {expected}")
        yield route


def count_shard(size: tuple[int, int], file: ShardFile) -> Counted:
    """Return the counts of one shard.

    Raises:
        DatasetError: The file is missing or damaged, or differs from its manifest.
    """
    counted = count_routes(_of_size(size, routes_of(file), file.path), size)
    counts, shard = counted.counts, file.shard
    found = (counts.labyrinths, counts.episodes, counts.rows)
    if found != (shard.labyrinths, shard.episodes, shard.rows):
        raise DatasetError(
            f"{file.path} holds {found[0]} labyrinths, {found[1]} episodes and "
            f"{found[2]} rows, but its manifest has other counts: overwrite=true rebuilds it"
        )
    return counted


@dataclass(frozen=True, eq=False)
class DatasetStatistics:
    """The statistics of one dataset, which is one config of a folder."""

    data: Dataset
    splits: Mapping[str, SplitCounts]
    """The counts of each split, in the order of the table of splits."""
    certificate: Certificate
    analysis: Mapping[str, Any] | None = None
    """The result of `analyse.read_analysis`."""

    @property
    def manifest(self) -> Manifest:
        """The manifest of the dataset."""
        return self.data.manifest

    @property
    def name(self) -> str:
        """The name of the dataset's config."""
        return self.manifest.config.name

    @property
    def rows(self) -> int:
        """The number of rows of all splits."""
        return sum(counts.rows for counts in self.splits.values())


_counted_last: dict[tuple[DatasetConfig, tuple[Shard, ...]], DatasetStatistics] = {}
"""The dataset that this process counted last, so that `card` need not count it after `analyse`."""


def count_dataset(
    data: Dataset,
    workers: int = 1,
    stage: str = "count",
    keep: Callable[[str, Content], None] | None = None,
) -> DatasetStatistics:
    """Return the statistics of a dataset, counted in its shards, without the analysis.

    Args:
        data: The dataset.
        workers: The number of processes.
        stage: The name to show beside the progress bar.
        keep: Called after each shard with the name of its split and its content. None to count
            nothing again, only to check the files, if this process counted the same dataset last.

    Raises:
        DatasetError: A shard is missing or damaged, or differs from the manifest.
    """
    config = data.manifest.config
    files = [file for split in config.splits for file in data.files(split)]
    rows = sum(file.shard.rows for file in files)
    known = None if keep else _counted_last.get((config, data.manifest.shards))
    if known is not None:
        checked = zip(files, ordered_map(_check, files, workers), strict=True)
        list(tracked(checked, stage, rows, lambda pair: pair[0].shard.rows))
        return replace(known, data=data)
    splits: dict[str, SplitCounts] = {}
    keys: dict[str, list[Keys]] = {}
    count = partial(count_shard, (config.height, config.width))
    done = zip(files, ordered_map(count, files, workers), strict=True)
    for file, counted in tracked(done, stage, rows, lambda pair: pair[0].shard.rows):
        split = file.shard.split
        before = splits.get(split)
        splits[split] = counted.counts if before is None else before + counted.counts
        keys.setdefault(split, []).append(counted.keys)
        if keep is not None:
            keep(split, counted.content)
    certificate = certify({split: Keys.joined(parts) for split, parts in keys.items()})
    statistics = DatasetStatistics(data, splits, certificate)
    _counted_last.clear()
    _counted_last[config, data.manifest.shards] = statistics
    return statistics


def _check(file: ShardFile) -> None:
    """Raise DatasetError if a shard is missing or damaged."""
    with file.opened():
        pass

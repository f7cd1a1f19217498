"""The pass over the rows of a dataset in which everything about it is counted.

What is in memory meanwhile is a shard's labyrinths, and three numbers of each labyrinth for the
certificate.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import chain
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.data.errors import DatasetError, one_line
from labyrinth_core.data.manifest import Manifest, Shard
from labyrinth_core.data.source import check_file
from labyrinth_core.data.storage import AnyPath
from labyrinth_core.world.grid import Action
from labyrinth_core.world.labyrinth import Labyrinth
from labyrinth_core.world.solver import optimal_actions
from pipeline.inspection.certificate import Keys, certify, size_of
from pipeline.inspection.counts import EXAMPLES, DatasetCounts, Example, SplitCounts
from pipeline.inspection.routes import Route, routes_of
from pipeline.machinery.executor import ordered_map


@dataclass(frozen=True, eq=False)
class Content:
    """The labyrinths of a split, in order, and what all episodes in each do together."""

    labyrinths: tuple[Labyrinth, ...]
    moves: NDArray[np.int64]
    """The number of moves of a shortest route, shape (labyrinths,)."""
    actions: NDArray[np.int64]
    """How often each action is taken, shape (labyrinths, 4)."""
    visits: NDArray[np.int64]
    """States with the agent in each cell, shape (labyrinths, height, width)."""

    @classmethod
    def joined(cls, parts: Sequence[Content]) -> Content:
        """Return the content of shards that follow one another."""
        labyrinths, *arrays = zip(*(vars(part).values() for part in parts), strict=True)
        return cls(tuple(chain.from_iterable(labyrinths)), *map(np.concatenate, arrays))


class Counted(NamedTuple):
    """What one pass over some episodes finds."""

    counts: SplitCounts
    keys: Keys
    content: Content


def count_routes(routes: Iterable[Route], size: tuple[int, int]) -> Counted:
    """Return the counts of episodes, those of a labyrinth one after the other.

    Raises:
        ValueError: A labyrinth is not of the size, height and width.
    """
    labyrinths: list[Labyrinth] = []
    examples: list[Example] = []
    moves, actions, visits = [], [], []
    lengths: Counter[int] = Counter()
    returned, choices, optimal = 0.0, 0, 0
    cells = size[0] * size[1]
    for route in routes:
        if route.is_first:
            if size_of(route.labyrinth) != size:
                held = route.labyrinth.size_name
                raise ValueError(f"a labyrinth is {held}, not {size[0]}x{size[1]}")
            labyrinths.append(route.labyrinth)
            moves.append(route.shortest)
            actions.append(np.zeros(len(Action), np.int64))
            visits.append(np.zeros(cells, np.int64))
            best = optimal_actions(route.labyrinth)
            if len(examples) < EXAMPLES:
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


def count_shard(folder: AnyPath, size: tuple[int, int], shard: Shard) -> Counted:
    """Return the counts of one shard.

    Raises:
        DatasetError: The file is missing, damaged, or not the manifest's.
    """
    try:
        counted = count_routes(routes_of(folder, shard), size)
    except ValueError as error:
        raise DatasetError(f"{folder / shard.path} cannot be read: {error}") from error
    counts = counted.counts
    found = (counts.labyrinths, counts.episodes, counts.rows)
    if not counts.rows or found != (shard.labyrinths, shard.episodes, shard.rows):
        raise DatasetError(
            f"{folder / shard.path} holds {found[0]} labyrinths, {found[1]} episodes and "
            f"{found[2]} rows, which is not what its manifest says: overwrite=true builds it "
            "anew"
        )
    return counted


def count_dataset(
    folder: AnyPath,
    manifest: Manifest,
    workers: int = 1,
    advance: Callable[[int], None] = lambda _: None,
    keep: Callable[[str, Content], None] = lambda *_: None,
) -> DatasetCounts:
    """Return the counts of a dataset, counted in its shards.

    Args:
        folder: The folder with its shards.
        manifest: Its manifest.
        workers: The number of processes.
        advance: Called after each shard with the number of its rows.
        keep: Called after each shard with the name of its split and its content.

    Raises:
        DatasetError: A shard is missing, damaged, or not the manifest's.
    """
    size = manifest.config.height, manifest.config.width
    shards = [shard for split in manifest.config.splits for shard in manifest.of(split)]
    splits: dict[str, SplitCounts] = {}
    keys: dict[str, list[Keys]] = {}
    done = ordered_map(partial(count_shard, folder, size), shards, workers)
    for shard, counted in zip(shards, done, strict=True):
        if splits.setdefault(shard.split, counted.counts) is not counted.counts:
            splits[shard.split].add(counted.counts)
        keys.setdefault(shard.split, []).append(counted.keys)
        keep(shard.split, counted.content)
        advance(shard.rows)
    certificate = certify({split: Keys.joined(parts) for split, parts in keys.items()})
    return DatasetCounts(splits, certificate)


def counts_of(
    folder: AnyPath,
    manifest: Manifest,
    workers: int = 1,
    advance: Callable[[int], None] = lambda _: None,
) -> DatasetCounts:
    """Return the counts that lie in the folder of a dataset; where there are none, count.

    The shards are compared with the manifest in either case. For the arguments see `count_dataset`.

    Raises:
        DatasetError: A shard is missing, damaged, or not the manifest's.
    """
    counts = DatasetCounts.read(folder, manifest)
    if counts is None:
        return count_dataset(folder, manifest, workers, advance)
    for shard in manifest.shards:
        path = folder / shard.path
        try:
            check_file(path, shard, path)
        except OSError as error:
            raise DatasetError(f"{path} cannot be read: {one_line(error)}") from error
        advance(shard.rows)
    return counts

"""The numbers of a dataset, counted in its shards."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.data.columns import SPLITS
from labyrinth_core.data.errors import DatasetError
from labyrinth_core.data.manifest import Manifest
from labyrinth_core.data.storage import AnyPath
from pipeline.machinery.executor import ordered_map
from pipeline.release.certificate import Certificate, Closeness, Structures, certify, read_closeness
from pipeline.release.tally import Example, Tally, TallyJob, tally_shard


@dataclass(frozen=True, eq=False)
class SplitStatistics:
    """The numbers of one split."""

    split: str
    labyrinths: int
    episodes: int
    rows: int
    lengths: Mapping[int, int]
    """Moves -> episodes of that many, the fewest moves first."""
    mean_return: float
    """Of an episode."""
    actions: NDArray[np.int64]
    """How often each action is taken, shape (4,)."""
    visits: NDArray[np.int64]
    """Rows with the agent in each cell, shape (height, width), row 0 at the bottom."""
    choices: float
    """Optimal actions in a state, a mean over the states acted in."""
    optimal: float
    """Share of the actions that are optimal."""
    loops: float
    """Passages beyond those of a tree (passages - cells + 1), a mean over the labyrinths."""
    examples: tuple[Example, ...]

    @property
    def mean_moves(self) -> float:
        """Moves of an episode, on average."""
        return (self.rows - self.episodes) / self.episodes

    @property
    def longest(self) -> int:
        """Moves of the longest episode."""
        return max(self.lengths)

    @property
    def action_shares(self) -> NDArray[np.float64]:
        """The share of each action, shape (4,)."""
        shares: NDArray[np.float64] = self.actions / self.actions.sum()
        return shares


@dataclass(frozen=True, eq=False)
class DatasetStatistics:
    """The numbers of one dataset, one config of a folder."""

    manifest: Manifest
    splits: tuple[SplitStatistics, ...]
    """In the order of the table of splits."""
    certificate: Certificate
    closeness: tuple[Closeness, ...]
    """Of the pairs of splits, empty if the stage `analyse` has not looked at these rows."""

    @property
    def name(self) -> str:
        """The name of its config."""
        return self.manifest.config.name

    @property
    def rows(self) -> int:
        """Rows of all splits."""
        return sum(split.rows for split in self.splits)

    def of(self, split: str) -> SplitStatistics:
        """Return the numbers of a split."""
        return self.splits[list(SPLITS).index(split)]


def measure(
    folder: AnyPath,
    manifest: Manifest,
    workers: int = 1,
    advance: Callable[[int], None] = lambda _: None,
) -> DatasetStatistics:
    """Return the statistics of a dataset.

    Args:
        folder: With its shards.
        manifest: Of that folder.
        workers: Processes.
        advance: Called after each shard with the number of its rows.

    Raises:
        DatasetError: A shard is missing, damaged, or not the manifest's.
    """
    cells = manifest.config.height * manifest.config.width
    jobs = [TallyJob(folder, shard, cells) for shard in manifest.shards]
    tallies: dict[str, Tally] = {}
    for job, tally in zip(jobs, ordered_map(tally_shard, jobs, workers), strict=True):
        if job.shard.split in tallies:
            tallies[job.shard.split].add(tally)
        else:
            tallies[job.shard.split] = tally
        advance(job.shard.rows)
    missing = [split for split in SPLITS if split not in tallies or not tallies[split].rows]
    if missing:
        raise DatasetError(f"{folder} has no rows of {', '.join(missing)}: build again")
    return DatasetStatistics(
        manifest=manifest,
        splits=tuple(_statistics(manifest, split, tallies[split]) for split in SPLITS),
        certificate=certify({split: _structures(tallies[split]) for split in SPLITS}),
        closeness=read_closeness(folder, manifest),
    )


def _statistics(manifest: Manifest, split: str, tally: Tally) -> SplitStatistics:
    labyrinths, episodes = len(tally.ids), tally.lengths.total()
    steps = tally.rows - episodes
    return SplitStatistics(
        split=split,
        labyrinths=labyrinths,
        episodes=episodes,
        rows=tally.rows,
        lengths=dict(sorted(tally.lengths.items())),
        mean_return=tally.returned / episodes,
        actions=np.array(tally.actions, np.int64),
        visits=tally.visits.reshape(manifest.config.height, manifest.config.width),
        choices=tally.choices / steps,
        optimal=tally.optimal / steps,
        loops=tally.loops / labyrinths,
        examples=tuple(tally.examples),
    )


def _structures(tally: Tally) -> Structures:
    return Structures(
        ids=np.array(tally.ids, np.int64),
        canonical_ids=np.array(tally.canonical_ids, np.int64),
    )

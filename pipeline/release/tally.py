"""Counts over the rows of a shard; the pictures in it are not read.

A shard is read a row group at a time, and tallies add up; so what is in memory is bounded by a
shard, but for two ids of each labyrinth.
"""

from __future__ import annotations

from array import array
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.data.columns import NO_ACTION, open_shard
from labyrinth_core.data.errors import DatasetError
from labyrinth_core.data.manifest import Shard
from labyrinth_core.data.storage import AnyPath, file_sha256, local_copy
from labyrinth_core.language.text import parse
from labyrinth_core.world.dynamics import initial, state_index, transition_table
from labyrinth_core.world.grid import Action
from labyrinth_core.world.labyrinth import Labyrinth
from labyrinth_core.world.solver import optimal_actions

EXAMPLES = 5
"""Labyrinths of each split that the pictures show."""

_COLUMNS = ["actions", "rewards", "episode_starts", "info"]


class Example(NamedTuple):
    """A labyrinth of a split with its first episode."""

    labyrinth: Labyrinth
    actions: tuple[int, ...]


class TallyJob(NamedTuple):
    """All that a worker needs to know to tally one shard."""

    folder: AnyPath
    shard: Shard
    cells: int
    """Of each labyrinth in it."""


@dataclass
class Tally:
    """Counts that are still growing."""

    visits: NDArray[np.int64]
    """Rows with the agent in each cell, shape (cells,)."""
    rows: int = 0
    lengths: Counter[int] = field(default_factory=Counter)
    """Moves -> episodes of that many."""
    returned: float = 0.0
    """Of all episodes together."""
    actions: list[int] = field(default_factory=lambda: [0] * len(Action))
    """How often each action is taken."""
    choices: int = 0
    """Optimal actions in the states acted in."""
    optimal: int = 0
    """Actions that are optimal."""
    loops: int = 0
    """Passages beyond those of a tree, of all labyrinths together."""
    ids: array[int] = field(default_factory=lambda: array("q"))
    """The `structure_id` of each labyrinth."""
    canonical_ids: array[int] = field(default_factory=lambda: array("q"))
    """That of its canonical form."""
    examples: list[Example] = field(default_factory=list)

    def add(self, other: Tally) -> None:
        """Add the counts of the shard that follows."""
        self.visits += other.visits
        self.rows += other.rows
        self.lengths += other.lengths
        self.returned += other.returned
        self.actions = [sum(pair) for pair in zip(self.actions, other.actions, strict=True)]
        self.choices += other.choices
        self.optimal += other.optimal
        self.loops += other.loops
        self.ids += other.ids
        self.canonical_ids += other.canonical_ids
        self.examples = (self.examples + other.examples)[:EXAMPLES]

    def count_labyrinth(self, labyrinth: Labyrinth, first: Sequence[int]) -> None:
        """Count a labyrinth, whose first episode takes the actions `first`."""
        structure = labyrinth.structure
        self.loops += structure.loops
        self.ids.append(int(structure.structure_id, 16))
        self.canonical_ids.append(int(structure.canonical().structure_id, 16))
        if len(self.examples) < EXAMPLES:
            self.examples.append(Example(labyrinth, tuple(first)))

    def count_episode(self, solved: Solved, actions: Sequence[int], returned: float) -> None:
        """Count an episode of a labyrinth."""
        cells = solved.labyrinth.structure.cells
        state = state_index(solved.labyrinth, initial(solved.labyrinth))
        self.visits[state % cells] += 1
        for action in actions:
            best = solved.optimal[state]
            self.choices += sum(best)
            self.optimal += best[action]
            self.actions[action] += 1
            state = solved.table[state][action]
            self.visits[state % cells] += 1
        self.rows += len(actions) + 1
        self.lengths[len(actions)] += 1
        self.returned += returned


class Solved(NamedTuple):
    """A labyrinth with what is known of each of its states."""

    labyrinth: Labyrinth
    table: Sequence[tuple[int, int, int, int]]
    """Where the actions lead."""
    optimal: list[list[bool]]
    """Which actions are optimal."""


def tally_shard(job: TallyJob) -> Tally:
    """Return the counts of one shard.

    Raises:
        DatasetError: The file is missing, damaged, or not the manifest's.
    """
    path, shard = job.folder / job.shard.path, job.shard
    tally = Tally(visits=np.zeros(job.cells, np.int64))
    before = None
    try:
        with local_copy(path) as file:
            if file_sha256(file) != shard.sha256:
                raise DatasetError(
                    f"{path} is not the file that its manifest describes: build again"
                )
            for info, actions, returned in _episodes(file):
                solved = _solved(info)
                if info != before:
                    tally.count_labyrinth(solved.labyrinth, actions)
                    before = info
                tally.count_episode(solved, actions, returned)
    except FileNotFoundError as error:
        raise DatasetError(f"{path} is missing: build again") from error
    except (ValueError, LookupError, TypeError) as error:
        reason = " ".join(str(error).partition("\n")[0].split())
        raise DatasetError(f"{path} cannot be read: {reason}") from error
    found = (len(tally.ids), tally.lengths.total(), tally.rows)
    if found != (shard.labyrinths, shard.episodes, shard.rows):
        raise DatasetError(
            f"{path} holds {found[0]} labyrinths, {found[1]} episodes and {found[2]} rows, "
            "which is not what its manifest says: build again"
        )
    return tally


def _episodes(path: Path) -> Iterator[tuple[str, list[int], float]]:
    """Yield `info`, the actions and the return of each episode.

    Raises:
        ValueError: It is no Parquet file (ArrowInvalid is one), or its rows make no episodes.
        LookupError: A column is missing.
    """
    import pyarrow as pa

    with open_shard(path) as file:
        rest: list[pa.Table] = []
        for group in range(file.num_row_groups):
            table = pa.concat_tables([*rest, file.read_row_group(group, columns=_COLUMNS)])
            starts = np.flatnonzero(table["episode_starts"].to_numpy())
            if not len(starts) or starts[0]:
                raise ValueError("a group of rows does not begin with an episode")
            infos = table["info"].take(starts).to_pylist()
            actions = table["actions"].to_numpy().tolist()
            sums = np.add.reduceat(table["rewards"].to_numpy().astype(np.float64), starts)
            ends = [*starts[1:].tolist(), len(actions)]
            episodes = list(zip(infos, starts.tolist(), ends, sums, strict=True))
            rest = []
            if actions[-1] != NO_ACTION and group + 1 < file.num_row_groups:  # It goes on there.
                rest = [table.slice(episodes.pop()[1])]
            for info, start, end, paid in episodes:
                taken = actions[start : end - 1]
                if actions[end - 1] != NO_ACTION or NO_ACTION in taken or not taken:
                    raise ValueError("an episode does not end with its last row, actions=-1")
                yield info, taken, float(paid)


@lru_cache(maxsize=1)
def _solved(info: str) -> Solved:
    labyrinth = parse(info)
    return Solved(labyrinth, transition_table(labyrinth), optimal_actions(labyrinth).tolist())

"""What a split of a finished dataset holds, as far as its analysis needs it; no pictures."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.dynamics import initial, state_index, transition_table
from labyrinth_core.grid import Action
from labyrinth_core.labyrinth import Labyrinth
from labyrinth_core.language import parse
from labyrinth_core.solver import distances
from pipeline.episodes import grouped
from pipeline.manifest import DatasetError, Shard
from pipeline.source import read_rows
from pipeline.storage import AnyPath


class ReadJob(NamedTuple):
    """All that a worker needs to know to read one shard."""

    folder: AnyPath
    shard: Shard


@dataclass(frozen=True, eq=False)
class Content:
    """The labyrinths of a split, in order, and what is done in each, all its episodes together."""

    labyrinths: tuple[Labyrinth, ...]
    moves: NDArray[np.int64]
    """Of a shortest route, shape (labyrinths,)."""
    actions: NDArray[np.int64]
    """How often each action is taken, shape (labyrinths, 4)."""
    visits: NDArray[np.int64]
    """States with the agent in each cell, shape (labyrinths, height, width)."""

    @classmethod
    def joined(cls, parts: list[Content]) -> Content:
        """Return the content of shards that follow one another."""
        return cls(
            tuple(each for part in parts for each in part.labyrinths),
            np.concatenate([part.moves for part in parts]),
            np.concatenate([part.actions for part in parts]),
            np.concatenate([part.visits for part in parts]),
        )


def read(job: ReadJob) -> Content:
    """Return the content of one shard.

    Raises:
        DatasetError: The file is missing, damaged, or not the manifest's.
    """
    labyrinths: list[Labyrinth] = []
    moves, actions, visits = [], [], []
    before = None
    for rows in grouped(read_rows(job.folder, [job.shard], pictures=False)):
        if rows[0].info != before:
            before = rows[0].info
            labyrinth = _parsed(before, job.shard.path)
            table = transition_table(labyrinth)
            cells = labyrinth.structure.cells
            start = state_index(labyrinth, initial(labyrinth))
            labyrinths.append(labyrinth)
            moves.append(distances(labyrinth, table)[start])
            actions.append([0] * len(Action))
            visits.append([0] * cells)
        state = start
        for row in rows[:-1]:
            visits[-1][state % cells] += 1
            actions[-1][row.actions] += 1
            state = table[state][row.actions]
        visits[-1][state % cells] += 1
    sizes = {(each.structure.height, each.structure.width) for each in labyrinths}
    if len(sizes) != 1:
        raise DatasetError(f"{job.shard.path} holds labyrinths of {len(sizes)} sizes, not of one")
    counts = np.array(visits, np.int64).reshape(len(labyrinths), *sizes.pop())
    return Content(tuple(labyrinths), np.array(moves), np.array(actions, np.int64), counts)


def _parsed(info: str, place: str) -> Labyrinth:
    try:
        return parse(info)
    except ValueError as error:
        reason = str(error).partition("\n")[0]
        raise DatasetError(f"{place}: a labyrinth cannot be read: {reason}") from error

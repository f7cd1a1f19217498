"""What a split of a finished dataset holds, as far as its analysis needs it; no pictures."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.data.errors import DatasetError
from labyrinth_core.data.manifest import Shard
from labyrinth_core.data.storage import AnyPath
from labyrinth_core.world.grid import Action
from labyrinth_core.world.labyrinth import Labyrinth
from pipeline.analysis.walks import walks_of


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
    for walk in walks_of(job.folder, job.shard):
        cells = walk.labyrinth.structure.cells
        if walk.is_first:
            labyrinths.append(walk.labyrinth)
            moves.append(walk.moves)
            actions.append(np.zeros(len(Action), np.int64))
            visits.append(np.zeros(cells, np.int64))
        actions[-1] += np.bincount(walk.actions, minlength=len(Action))
        visits[-1] += np.bincount(np.array(walk.states) % cells, minlength=cells)
    sizes = {(each.structure.height, each.structure.width) for each in labyrinths}
    if len(sizes) != 1:
        raise DatasetError(f"{job.shard.path} holds labyrinths of {len(sizes)} sizes, not of one")
    counts = np.stack(visits).reshape(len(labyrinths), *sizes.pop())
    return Content(tuple(labyrinths), np.array(moves), np.stack(actions), counts)

"""A split as the report's page needs it: its labyrinths and episodes packed, and counts over all.

A labyrinth is a few numbers and two bit sets of passages; an episode is two bits an action. The
page draws the pictures from that, so they are not stored.
"""

from __future__ import annotations

import base64
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.data.columns import SPLITS
from labyrinth_core.data.errors import DatasetError
from labyrinth_core.data.manifest import Manifest, Shard
from labyrinth_core.language.text import labyrinth_id
from labyrinth_core.world.grid import Action
from labyrinth_core.world.labyrinth import Labyrinth
from pipeline.analysis.walks import Walk, walks_of
from pipeline.machinery.executor import ordered_map

_NUMBER_BYTES = 4
"""What a number is counted as; in the page it takes as little as the largest of its column."""


class PackJob(NamedTuple):
    """All that a worker needs to know to pack one shard."""

    folder: Path
    shard: Shard
    cells: int
    """Of each labyrinth in it."""


@dataclass
class PackedSplit:
    """Labyrinths with their episodes, in order, and counts that go over all there were."""

    visits: NDArray[np.int64]
    """States with the agent in each cell, shape (cells,)."""
    labyrinths: int = 0
    episodes: int = 0
    moves: Counter[int] = field(default_factory=Counter)
    """Moves of a shortest route -> labyrinths."""
    loops: Counter[int] = field(default_factory=Counter)
    """Passages beyond those of a tree -> labyrinths."""
    junctions: Counter[int] = field(default_factory=Counter)
    """Cells where ways part -> labyrinths."""
    actions: NDArray[np.int64] = field(default_factory=lambda: np.zeros(len(Action), np.int64))
    """How often each action is taken, shape (4,)."""
    fixed: dict[str, bytearray] = field(default_factory=dict)
    """Columns of which each labyrinth has as many bytes."""
    numbers: dict[str, list[int]] = field(default_factory=dict)
    """Columns of one number a labyrinth; `length`, one an episode."""
    route: bytearray = field(default_factory=bytearray)
    """The actions of all episodes, one after the other."""

    @property
    def size(self) -> int:
        """Bytes that what is packed takes in the page, at most."""
        numbers = sum(map(len, self.numbers.values()))
        fixed = sum(map(len, self.fixed.values()))
        return fixed + _NUMBER_BYTES * numbers + len(self.route) // 4

    def add_labyrinth(self, labyrinth: Labyrinth, moves: int) -> None:
        """Add a labyrinth, whose shortest route has so many moves; its episodes are to follow."""
        structure = labyrinth.structure
        self.labyrinths += 1
        self.moves[moves] += 1
        self.loops[structure.loops] += 1
        self.junctions[structure.junctions] += 1
        wide = (structure.cells + 7) // 8
        for name, value in {
            "id": bytes.fromhex(labyrinth_id(labyrinth)),
            "structure": bytes.fromhex(structure.structure_id),
            "up": structure.up.to_bytes(wide, "little"),
            "right": structure.right.to_bytes(wide, "little"),
        }.items():
            self.fixed.setdefault(name, bytearray()).extend(value)
        if labyrinth.ice:
            ice = sum(1 << cell for cell in labyrinth.ice)
            self.fixed.setdefault("ice", bytearray()).extend(ice.to_bytes(wide, "little"))
        numbers = {"start": labyrinth.start, "goal": labyrinth.goal, "moves": moves}
        numbers |= {"loops": structure.loops, "episodes": 0}
        if labyrinth.key is not None and labyrinth.door is not None:
            numbers |= {"key": labyrinth.key, "door": labyrinth.door}
        for name, number in numbers.items():
            self.numbers.setdefault(name, []).append(number)

    def add_episode(self, walk: Walk) -> None:
        """Add an episode of the labyrinth added last."""
        self.episodes += 1
        self.numbers["episodes"][-1] += 1
        self.numbers.setdefault("length", []).append(len(walk.actions))
        self.route.extend(walk.actions)
        self.actions += np.bincount(walk.actions, minlength=len(Action))
        cells = len(self.visits)
        self.visits += np.bincount(np.array(walk.states) % cells, minlength=cells)

    def add(self, other: PackedSplit, limit: int) -> None:
        """Add the shard that follows, packed only while there is room for `limit` bytes."""
        self.visits += other.visits
        self.actions += other.actions
        self.labyrinths += other.labyrinths
        self.episodes += other.episodes
        for counts, more in (
            (self.moves, other.moves),
            (self.loops, other.loops),
            (self.junctions, other.junctions),
        ):
            counts.update(more)
        if self.size <= limit:
            for name, column in other.fixed.items():
                self.fixed.setdefault(name, bytearray()).extend(column)
            for name, values in other.numbers.items():
                self.numbers.setdefault(name, []).extend(values)
            self.route.extend(other.route)

    def to_json(self, limit: int) -> dict[str, Any]:
        """Return the counts of all labyrinths, and as many of the first as take `limit` bytes."""
        episodes = np.cumsum(self.numbers["episodes"])
        lengths = np.concatenate([[0], np.cumsum(self.numbers["length"])])
        ofeach = sum(map(len, self.fixed.values())) // len(episodes)
        ofeach += _NUMBER_BYTES * (len(self.numbers) - 1)
        taken = ofeach * np.arange(1, len(episodes) + 1)
        taken = taken + _NUMBER_BYTES * episodes + lengths[episodes] // 4
        shown = int(np.searchsorted(taken, limit, side="right"))
        kept = int(episodes[shown - 1]) if shown else 0
        columns = {
            name: _base64(column[: shown * len(column) // len(episodes)])
            for name, column in self.fixed.items()
        }
        for name, values in self.numbers.items():
            columns[name] = _packed(values[: kept if name == "length" else shown])
        columns["actions"] = _base64(_quarters(self.route[: lengths[kept]]))
        return {
            "labyrinths": self.labyrinths,
            "episodes": self.episodes,
            "shown": shown,
            "moves": sorted(self.moves.items()),
            "loops": sorted(self.loops.items()),
            "junctions": sorted(self.junctions.items()),
            "actions": self.actions.tolist(),
            "visits": self.visits.tolist(),
            "columns": columns,
        }


def _packed(values: Sequence[int]) -> dict[str, str]:
    kind = np.min_scalar_type(max(values, default=0))
    array = np.array(values, kind.newbyteorder("<"))
    return {"type": kind.name, "data": _base64(array.tobytes())["data"]}


def _base64(data: bytes | bytearray) -> dict[str, str]:
    return {"type": "bytes", "data": base64.b64encode(data).decode()}


def _quarters(actions: bytes | bytearray) -> bytes:
    """Return actions in two bits each, the first in the lowest of its byte."""
    padded = np.zeros(-(-len(actions) // 4) * 4, np.uint8)
    padded[: len(actions)] = np.frombuffer(actions, np.uint8)
    packed: NDArray[np.uint8] = (padded.reshape(-1, 4) << np.array([0, 2, 4, 6], np.uint8)).sum(
        axis=1, dtype=np.uint8
    )
    return packed.tobytes()


def pack_walks(walks: Iterable[Walk], cells: int) -> PackedSplit:
    """Return episodes packed.

    Args:
        walks: The episodes; those of a labyrinth follow one another.
        cells: Of each labyrinth.

    Raises:
        DatasetError: A labyrinth is of another size.
    """
    packed = PackedSplit(visits=np.zeros(cells, np.int64))
    for walk in walks:
        if walk.is_first:
            if walk.labyrinth.structure.cells != cells:
                held = walk.labyrinth.structure.cells
                raise DatasetError(f"a labyrinth has {held} cells, not {cells}")
            packed.add_labyrinth(walk.labyrinth, walk.moves)
        packed.add_episode(walk)
    return packed


def pack_shard(job: PackJob) -> PackedSplit:
    """Return what is in one shard.

    Raises:
        DatasetError: The file is missing, damaged, or its rows do not make episodes.
    """
    return pack_walks(walks_of(job.folder, job.shard), job.cells)


def pack(
    folder: Path,
    manifest: Manifest,
    limit: int,
    workers: int = 1,
    advance: Callable[[int], None] = lambda _: None,
) -> dict[str, PackedSplit]:
    """Return the splits of a dataset.

    Args:
        folder: With its shards.
        manifest: Of that folder.
        limit: About how many bytes of each split to pack.
        workers: Processes.
        advance: Called after each shard with the number of its rows.

    Raises:
        DatasetError: A shard is missing, damaged, or its rows do not make episodes.
    """
    cells = manifest.config.height * manifest.config.width
    jobs = [PackJob(folder, shard, cells) for shard in manifest.shards]
    splits: dict[str, PackedSplit] = {}
    for job, packed in zip(jobs, ordered_map(pack_shard, jobs, workers), strict=True):
        if job.shard.split in splits:
            splits[job.shard.split].add(packed, limit)
        else:
            splits[job.shard.split] = packed
        advance(job.shard.rows)
    return {split: splits[split] for split in SPLITS if split in splits}

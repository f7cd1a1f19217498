"""The labyrinths and episodes of a split, packed for the report's page.

A labyrinth takes a few numbers and two bit sets of passages, an episode two bits per action. The
page draws the pictures from these, so none are stored.
"""

from __future__ import annotations

import base64
from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np

from labyrinth_core.data import Dataset, ShardFile
from labyrinth_core.language import labyrinth_id
from labyrinth_core.world import Labyrinth
from pipeline.inspection import Route, SplitCounts, routes_of
from pipeline.machinery import ordered_map

_NUMBER_BYTES = 4
"""The bytes counted per number; the page uses as few as the largest of the column needs."""


@dataclass
class PackedSplit:
    """Labyrinths with their episodes, in order."""

    fixed: dict[str, bytearray] = field(default_factory=lambda: defaultdict(bytearray))
    """Columns with the same number of bytes for each labyrinth."""
    numbers: dict[str, list[int]] = field(default_factory=lambda: defaultdict(list))
    """Columns with one number per labyrinth; `length` has one per episode."""
    actions: bytearray = field(default_factory=bytearray)
    """The actions of all episodes, one after the other."""

    @property
    def size(self) -> int:
        """The maximum number of bytes that the split takes in the page, before base64."""
        numbers = sum(map(len, self.numbers.values()))
        fixed = sum(map(len, self.fixed.values()))
        return fixed + _NUMBER_BYTES * numbers + len(self.actions) // 4

    def add(self, route: Route) -> None:
        """Add an episode; episodes must be grouped by labyrinth."""
        if route.is_first:
            self._add_labyrinth(route.labyrinth, route.solver.moves)
        self.numbers["episodes"][-1] += 1
        self.numbers["length"].append(len(route.actions))
        self.actions.extend(route.actions)

    def extend(self, other: PackedSplit) -> None:
        """Add the next shard."""
        for name, column in other.fixed.items():
            self.fixed[name] += column
        for name, values in other.numbers.items():
            self.numbers[name] += values
        self.actions.extend(other.actions)

    def _add_labyrinth(self, labyrinth: Labyrinth, shortest: int) -> None:
        structure = labyrinth.structure
        wide = (structure.cells + 7) // 8
        self.fixed["id"] += bytes.fromhex(labyrinth_id(labyrinth))
        self.fixed["structure"] += bytes.fromhex(structure.structure_id)
        self.fixed["up"] += structure.up.to_bytes(wide, "little")
        self.fixed["right"] += structure.right.to_bytes(wide, "little")
        rules = labyrinth.task.rules
        for name in rules.grounds:
            cells = sum(1 << cell for cell in getattr(labyrinth, name))
            self.fixed[name] += cells.to_bytes(wide, "little")
        numbers = {"start": labyrinth.start, "goal": labyrinth.goal, "moves": shortest}
        numbers |= {"loops": structure.loops, "episodes": 0}
        numbers |= {name: getattr(labyrinth, name) for name in rules.singles}
        for name, number in numbers.items():
            self.numbers[name].append(number)

    def to_json(self, counts: SplitCounts, limit: int) -> dict[str, Any]:
        """Return the counts of all labyrinths, and the first ones that fit in `limit` bytes."""
        episodes = np.cumsum(self.numbers["episodes"])
        lengths = np.concatenate([[0], np.cumsum(self.numbers["length"])])
        of_each = sum(map(len, self.fixed.values())) // len(episodes)
        of_each += _NUMBER_BYTES * (len(self.numbers) - 1)
        taken = of_each * np.arange(1, len(episodes) + 1)
        taken = taken + _NUMBER_BYTES * episodes + lengths[episodes] // 4
        shown = int(np.searchsorted(taken, limit, side="right"))
        kept = int(episodes[shown - 1]) if shown else 0
        columns = {
            name: _base64(column[: shown * len(column) // len(episodes)])
            for name, column in self.fixed.items()
        }
        for name, values in self.numbers.items():
            columns[name] = _packed(values[: kept if name == "length" else shown])
        columns["actions"] = _base64(_quarters(self.actions[: lengths[kept]]))
        return {
            "labyrinths": counts.labyrinths,
            "episodes": counts.episodes,
            "shown": shown,
            "moves": sorted(counts.moves.items()),
            "loops": sorted(counts.loops.items()),
            "junctions": sorted(counts.junctions.items()),
            "actions": counts.actions.tolist(),
            "visits": counts.visits.ravel().tolist(),
            "columns": columns,
        }


def _packed(values: Sequence[int]) -> dict[str, str]:
    kind = np.min_scalar_type(max(values, default=0))
    array = np.array(values, kind.newbyteorder("<"))
    return {"type": kind.name, "data": _base64(array.tobytes())["data"]}


def _base64(data: bytes | bytearray) -> dict[str, str]:
    return {"type": "bytes", "data": base64.b64encode(data).decode()}


def _quarters(actions: bytes | bytearray) -> bytes:
    """Return actions in two bits each, the first in the lowest bits of its byte."""
    column = np.frombuffer(actions, np.uint8)[:, None]
    bits = np.unpackbits(column, axis=1, count=2, bitorder="little")
    return np.packbits(bits, bitorder="little").tobytes()


def pack_routes(routes: Iterable[Route], limit: int) -> PackedSplit:
    """Return packed episodes of as many labyrinths as fit in about `limit` bytes.

    Args:
        routes: The episodes, grouped by labyrinth.
        limit: About how many bytes to pack; at least one labyrinth is packed.
    """
    packed = PackedSplit()
    for route in routes:
        if route.is_first and packed.size > limit:
            break
        packed.add(route)
    return packed


def _pack_shard(limit: int, file: ShardFile) -> PackedSplit:
    return pack_routes(routes_of(file), limit)


def pack(data: Dataset, split: str, limit: int, workers: int = 1) -> PackedSplit:
    """Return the first labyrinths of a split of a dataset, packed as by `pack_routes`.

    Raises:
        DatasetError: A shard is missing or damaged, or its rows do not form episodes.
    """
    packed = PackedSplit()
    for part in ordered_map(partial(_pack_shard, limit), data.files(split), workers):
        packed.extend(part)
        if packed.size > limit:
            break
    return packed

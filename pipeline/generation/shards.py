"""One shard: the job that describes it, and how it is solved, rendered and written.

A shard that is there already is not made again. So a build that was stopped goes on, parts are put
together, and a dataset is mended or grows.
"""

from __future__ import annotations

import hashlib
import json
import shutil
from collections import deque
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from functools import partial
from itertools import islice
from typing import TypeVar

import numpy as np

from labyrinth_core.data.dataset_config import DatasetConfig
from labyrinth_core.data.errors import MALFORMED, DatasetError
from labyrinth_core.data.manifest import MANIFEST, Shard
from labyrinth_core.data.splits import SHIFTS
from labyrinth_core.data.storage import AnyPath, file_sha256, write_bytes
from labyrinth_core.language.text import dump
from labyrinth_core.world.labyrinth import Labyrinth, LabyrinthError, Structure
from pipeline.generation.candidates import Records
from pipeline.generation.fingerprint import Row
from pipeline.generation.render import render
from pipeline.generation.solve import solve
from pipeline.generation.tabulate import FACTS, Facts, FactsOfShard, table_facts
from pipeline.generation.variants import labyrinth_and_parent
from pipeline.generation.write import write
from pipeline.machinery.dataset import build_versions
from pipeline.machinery.folders import new_file

CELLS_PER_BATCH = 2_000
"""The cells of the labyrinths that each step takes at once: 80 labyrinths at 5x5."""

Item = TypeVar("Item")


@dataclass(frozen=True)
class ShardThere:
    """A shard of the finished dataset that is to be mended or to grow."""

    path: AnyPath
    shard: Shard
    table_row: int | None = None
    """The row of its first labyrinth in the table of labyrinths; None if the file is damaged."""


@dataclass(frozen=True)
class ShardJob:
    """All that a worker needs to make one shard; equal jobs give equal bytes."""

    config: DatasetConfig
    split: str
    first: int
    """The index of its first labyrinth in the split."""
    structures: Records
    path: AnyPath
    building: AnyPath
    """The folder of the file that is left beside it."""
    there: ShardThere | None = None
    """The shard of the same structures in the finished dataset, if it has one."""

    @property
    def sidecar(self) -> AnyPath:
        """The file that marks the shard as finished, and describes it: see `leave`."""
        return self.building / f"{self.path.name.removesuffix('.parquet')}.shard"

    @property
    def key(self) -> str:
        """A hash of all that the bytes of the shard follow from."""
        config = replace(self.config, labyrinths=1, shifts=()).to_json()
        parts = config, build_versions(), self.split, self.first, self.structures.tobytes()
        return hashlib.sha256(repr(parts).encode()).hexdigest()


def not_as_it_was(path: AnyPath) -> str:
    """Return why a file that was made anew is not kept."""
    return (
        f"{path} cannot be made again as its {MANIFEST} says, which names the versions that it "
        "was made with: overwrite=true builds the whole dataset anew"
    )


def finished(job: ShardJob) -> Shard | None:
    """Return the shard of a job if it is there already, None if it has to be made.

    Either an earlier run has made it, or the finished dataset has it.
    """
    with suppress(FileNotFoundError, *MALFORMED):
        key, shard, _ = left(job)
        if key == job.key and file_sha256(job.path) == shard.sha256:
            return shard
    there = job.there
    if there is not None and there.table_row is not None:
        with suppress(FileNotFoundError):
            if file_sha256(there.path) == there.shard.sha256:
                with new_file(job.path, job.building) as path:
                    shutil.copyfile(str(there.path), path)
                shard = replace(there.shard, path=job.path.name)
                facts = table_facts(there.path.parent, there.table_row, shard.labyrinths)
                return leave(job, shard, facts)
    return None


def make_shard(job: ShardJob) -> Shard:
    """Make the shard of a job, or return the one that is there already.

    Raises:
        DatasetError: The finished dataset has the shard with other bytes.
    """
    if (there := finished(job)) is not None:
        return there
    config, split, cut = job.config, job.split, 0
    facts = FactsOfShard(split)
    waiting: deque[tuple[int, Labyrinth | None]] = deque()
    """The number and the parent of each labyrinth that is being solved."""

    def labyrinths() -> Iterator[Labyrinth]:
        for number, passages in enumerate(job.structures["passages"], start=job.first):
            structure = Structure.from_bytes(config.height, config.width, passages.tobytes())
            try:
                labyrinth, parent = labyrinth_and_parent(config, split, structure)
            except LabyrinthError:
                if split not in SHIFTS:
                    raise
                continue  # Its parent has no such variant.
            waiting.append((number, parent))
            yield labyrinth

    def episodes() -> Iterator[list[Row]]:
        nonlocal cut
        batch = max(1, CELLS_PER_BATCH // (config.height * config.width))
        solutions = map(partial(solve, config, split), batched(labyrinths(), batch))
        for solution in batched(solutions, batch):
            number, parent = waiting.popleft()
            info = dump(solution.labyrinth)
            yield from render(split, number, info, solution.episodes)
            facts.add(info, solution, parent)
            cut += config.is_cut(split, len(solution.episodes))

    with new_file(job.path, job.building) as path:
        shard = write(path, split, episodes())
        if job.there is not None and job.there.shard.sha256 != shard.sha256:
            raise DatasetError(not_as_it_was(job.there.path))
    found = facts.array()
    return leave(job, replace(shard, cut=cut, labyrinths=len(found)), found)


def leave(job: ShardJob, shard: Shard, facts: Facts) -> Shard:
    """Mark a shard as finished by its sidecar: a line of JSON, and its facts as an array."""
    line = json.dumps({"key": job.key, "shard": asdict(shard)})
    write_bytes(job.sidecar, f"{line}\n".encode() + facts.tobytes())
    return shard


def left(job: ShardJob) -> tuple[str, Shard, Facts]:
    """Return what the sidecar of a job holds: the key of its job, its shard and the facts.

    Raises:
        FileNotFoundError: The shard is not finished.
        MALFORMED: The file is damaged; any of these errors.
    """
    line, _, array = job.sidecar.read_bytes().partition(b"\n")
    content, facts = json.loads(line), np.frombuffer(array, FACTS)
    shard = Shard.from_json(content["shard"])
    if len(facts) != shard.labyrinths:
        raise ValueError(f"{job.sidecar} holds the facts of {len(facts)} labyrinths")
    return content["key"], shard, facts


def batched(items: Iterable[Item], count: int) -> Iterator[Item]:
    """Yield the items, made `count` at a time.

    Between two stages this keeps the processor at one kind of work for longer. A build that took
    labyrinths one by one would cost 8% to 15% more (600 labyrinths at 5x5, CPU time, 12 rounds).
    """
    iterator = iter(items)
    while batch := list(islice(iterator, count)):
        yield from batch

"""The plan of a build: the shards to make, and those that stay as a shorter dataset has them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.data.errors import DatasetError
from labyrinth_core.data.manifest import FORMAT, FORMAT_OF_CHUNKS, Manifest
from labyrinth_core.data.splits import SPLITS
from labyrinth_core.data.storage import AnyPath
from pipeline.config.run import Run
from pipeline.generation.candidates import Candidates, Chunk, Records, draw_chunk
from pipeline.generation.sample import sample
from pipeline.generation.shards import ShardJob, ShardThere
from pipeline.generation.tabulate import structures_in
from pipeline.generation.workplace import Workplace
from pipeline.machinery.console import say, tracked
from pipeline.machinery.dataset import build_versions
from pipeline.machinery.executor import ordered_map
from pipeline.machinery.markdown import count


class Plan(NamedTuple):
    """All shards of a dataset, before they are made."""

    jobs: list[ShardJob]
    """In the order of the manifest."""
    format: int
    """The format of the manifest."""


def plan_shards(
    run: Run,
    workplace: Workplace,
    cells_per_shard: int,
    cells_per_chunk: tuple[int, int],
    shorter: Manifest | None = None,
) -> Plan:
    """Return what there is to make; workers draw the candidates if there are many.

    Args:
        run: The run.
        workplace: Where it builds.
        cells_per_shard: As for `run`.
        cells_per_chunk: As for `run`.
        shorter: The dataset of the same folder that grows, if one does.

    Raises:
        ConfigError: There are fewer labyrinths than asked for.
        DatasetError: A dataset cannot grow.
    """
    config, building = run.dataset, workplace.building

    def draw(chunks: Sequence[Chunk]) -> Iterator[Records]:
        jobs = [(chunk, building) for chunk in chunks]
        if run.part is not None:  # Each begins with its own, and draws what others have not.
            part, parts = run.part
            own = len(jobs) * (part - 1) // parts
            jobs = jobs[own:] + jobs[:own]
        drawn = ordered_map(draw_chunk, jobs, run.options.workers)
        for _ in tracked(((1, chunk) for chunk in drawn), "draw", total=len(jobs)):
            pass
        return (chunk.read(building) for chunk in chunks)

    candidates = Candidates(config, draw, cells=cells_per_chunk)
    sampled = sample(config, candidates)
    size = max(1, cells_per_shard // (config.height * config.width))
    shards = -(-config.labyrinths // size)
    there = {} if shorter is None else _shards_there(run.folder, shorter, sampled.structures)
    jobs = []
    for split in config.splits:
        of_split = sampled.structures[SPLITS[split].parent or split]
        for first in range(0, config.labyrinths, size):
            structures = of_split[first : first + size]
            name = f"{split}-{first // size:05d}-of-{shards:05d}.parquet"
            found = there.get((split, structures["id"].tobytes()))
            path = workplace.shards / name
            jobs.append(ShardJob(config, split, first, structures, path, building, found))
    if shorter is not None:
        stay = sum(job.there is not None for job in jobs)
        say(f"{run.folder} grows: {stay} of {count(len(jobs), 'shard')} stay.")
    in_one_chunk = sampled.candidates <= candidates.first.size
    return Plan(jobs, FORMAT if in_one_chunk else FORMAT_OF_CHUNKS)


def _shards_there(
    folder: AnyPath, shorter: Manifest, structures: Mapping[str, Records]
) -> dict[tuple[str, bytes], ShardThere]:
    """Return the shards of the dataset that grows, by their split and the ids of their structures.

    The structures of a split with a parent are those of the parent. If the dataset was built with
    other versions of libraries, no shard is as it would be made now.

    Args:
        folder: The folder of the shorter dataset.
        shorter: Its manifest.
        structures: The structures of the longer one, for each split that has its own.

    Raises:
        DatasetError: The longer one would not have all labyrinths of the shorter one; or the table
            of the shorter one is missing or damaged.
    """
    ids, row = structures_in(folder, shorter), 0
    there: dict[tuple[str, bytes], ShardThere] = {}
    of_shards: dict[str, list[NDArray[np.int64]]] = {}
    for split in shorter.config.splits:
        own, begin = of_shards.setdefault(split, []), row
        for shard in shorter.of(split):
            own.append(ids[row : row + shard.labyrinths])
            its = of_shards[SPLITS[split].parent or split][len(own) - 1]
            there[split, its.tobytes()] = ShardThere(folder / shard.path, shard, row)
            row += shard.labyrinths
        if SPLITS[split].parent is None:
            longer = structures[split]["id"]
            if not np.array_equal(ids[begin:row], longer[: row - begin]):
                raise DatasetError(
                    f"{folder} holds labyrinths that are not in the dataset with more labyrinths "
                    "or shifts: choose another data_dir, or give overwrite=true"
                )
    return there if dict(shorter.versions) == build_versions() else {}

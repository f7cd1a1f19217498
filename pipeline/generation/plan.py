"""The plan of a build: the shards to make, and those that stay as a shorter dataset has them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from labyrinth_core.data.errors import DatasetError
from labyrinth_core.data.manifest import FORMAT, FORMAT_OF_CHUNKS, Manifest
from labyrinth_core.data.splits import SPLITS
from pipeline.config.run import Run
from pipeline.generation.candidates import Candidates, Chunk, Records, draw_chunk
from pipeline.generation.sample import sample
from pipeline.generation.shards import OldShard, ShardJob
from pipeline.generation.tabulate import Facts, table_facts
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
    old: dict[tuple[str, int], OldShard] = {}
    if shorter is not None and isinstance(run.folder, Path):
        old = unchanged(run.folder, shorter, config.labyrinths, sampled.structures, size)
        total = count(shards * len(config.splits), "shard")
        say(f"{run.folder} grows: {len(old)} of {total} stay.")
    jobs = [
        ShardJob(
            config,
            split,
            first,
            sampled.structures[SPLITS[split].parent or split][first : first + size],
            workplace.shards / f"{split}-{first // size:05d}-of-{shards:05d}.parquet",
            building,
            old=old.get((split, first)),
        )
        for split in config.splits
        for first in range(0, config.labyrinths, size)
    ]
    in_one_chunk = sampled.candidates <= candidates.first.size
    return Plan(jobs, FORMAT if in_one_chunk else FORMAT_OF_CHUNKS)


def unchanged(
    folder: Path,
    shorter: Manifest,
    labyrinths: int,
    structures: Mapping[str, Records],
    size: int,
) -> dict[tuple[str, int], OldShard]:
    """Return the shards that stay as they are, by split and the number of the first labyrinth.

    Those are all in which no labyrinth is to be added, or none if it was built with other versions
    of libraries.

    Args:
        folder: The folder of the shorter dataset.
        shorter: Its manifest.
        labyrinths: The number of labyrinths in each split of the longer one.
        structures: The structures of the longer one, for each split that has its own.
        size: The number of labyrinths in a shard.

    Raises:
        DatasetError: The longer one would not have all labyrinths of the shorter one; or the table
            of the shorter one is missing or damaged.
    """
    facts, first, kept = table_facts(folder, shorter), 0, {}
    same_versions = dict(shorter.versions) == build_versions()
    for split in shorter.config.splits:
        shards, begin = shorter.of(split), first
        for number, shard in enumerate(shards):
            own = facts[first : first + shard.labyrinths]
            first += shard.labyrinths
            is_full = min((number + 1) * size, labyrinths) <= shorter.config.labyrinths
            if is_full and same_versions:
                kept[split, number * size] = OldShard(folder / shard.path, shard, own)
        if split in structures:
            _check_first(folder, facts[begin:first], structures[split])
    return kept


def _check_first(folder: Path, facts: Facts, records: Records) -> None:
    if not np.array_equal(facts["structure_id"], records["id"][: len(facts)]):
        raise DatasetError(
            f"{folder} holds labyrinths that are not in the dataset with more labyrinths or "
            "shifts: choose another data_dir, or give overwrite=true"
        )

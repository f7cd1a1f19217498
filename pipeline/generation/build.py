"""The build, which composes sample, solve, render and write; the manifest comes last.

A local dataset is built in `.NAME.building` beside its final folder, and moved there once finished.
In an object store, which cannot rename, shards are uploaded under their final names, and the
manifest makes them a dataset. Either way each finished shard has a sidecar in `.NAME.building`,
from which a build that was stopped goes on.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from itertools import islice
from typing import TypeVar

from labyrinth_core.data.columns import SAMPLED_SPLITS, SPLITS, Row
from labyrinth_core.data.dataset_config import DatasetConfig
from labyrinth_core.data.errors import DatasetError
from labyrinth_core.data.labyrinth_table import TABLE
from labyrinth_core.data.manifest import MANIFEST, Manifest, Shard, TableFile, current_versions
from labyrinth_core.data.storage import (
    AnyPath,
    RemotePath,
    file_sha256,
    new_file,
    write_bytes,
    write_text,
)
from labyrinth_core.world.labyrinth import Labyrinth, Structure
from pipeline.config.errors import ConfigError
from pipeline.config.run import Run
from pipeline.generation.render import render
from pipeline.generation.sample import check_capacity, labyrinth_and_parent, stream
from pipeline.generation.solve import solve
from pipeline.generation.tabulate import FactsOfShard, facts_path, read_facts, write_table
from pipeline.generation.workplace import Workplace
from pipeline.generation.write import write
from pipeline.machinery import front_matter
from pipeline.machinery.console import console, summary, tracked
from pipeline.machinery.executor import ordered_map
from pipeline.machinery.locks import held

CELLS_PER_SHARD = 400_000
"""The number of cells of all labyrinths in a shard: 16,000 at 5x5, some tens of megabytes."""

CELLS_PER_BATCH = 2_000
"""The number of cells of the labyrinths that each stage takes at once: 80 labyrinths at 5x5."""

Item = TypeVar("Item")


@dataclass(frozen=True)
class ShardJob:
    """All that a worker needs to make one shard; equal jobs give equal bytes."""

    config: DatasetConfig
    split: str
    first: int
    """The index of its first labyrinth in the split."""
    structures: list[Structure]
    path: AnyPath
    sidecar: AnyPath
    """The file that marks the shard as finished, and describes it."""
    facts: AnyPath
    """The file of its part of the table of labyrinths."""


def run(run: Run) -> None:
    """Build the dataset of a run, unless it is there already.

    Raises:
        ConfigError: There are fewer labyrinths than asked for.
        DatasetError: The folder holds another dataset, or other files.
        OSError: The folder cannot be written.
    """
    workplace = Workplace(run.folder)
    with held(run.data_dir, run.dataset.name):
        workplace.recover()
        manifest = None if run.options.overwrite else _finished(run)
        if manifest is not None:
            console.print(f"{run.folder} is complete already.", highlight=False, soft_wrap=True)
            if workplace.is_for(run.dataset) or not workplace.has_begun:
                workplace.clear()  # A run was killed at the very end.
        else:
            check_capacity(run.dataset)
            front_matter.read(run.data_dir / "README.md")  # Not somebody else's.
            manifest = _build(run, workplace)
    with held(run.data_dir, "README.md"):
        front_matter.update(run.data_dir)
    console.print(summary(manifest))
    _report_cut(manifest)
    load = "load_transitions" if isinstance(run.data_dir, RemotePath) else "load_dataset"
    console.print(f'{load}("{run.data_dir}", "{run.dataset.name}")', soft_wrap=True)


def _finished(run: Run) -> Manifest | None:
    """Return the manifest of the dataset if it is finished, and was built with the same options."""
    folder = run.folder
    if not (folder / MANIFEST).is_file():
        unfinished = isinstance(folder, RemotePath) and Workplace(folder).has_begun
        if not unfinished and folder.exists() and any(folder.iterdir()):
            raise DatasetError(
                f"{folder} holds files but no finished dataset: move them, choose another "
                "data_dir, or give overwrite=true to replace them"
            )
        return None
    manifest = Manifest.read(folder)
    there, wanted = asdict(manifest.config), asdict(run.dataset)
    differing = [
        f"{key}={there[key]}, not {wanted[key]}" for key in there if there[key] != wanted[key]
    ]
    if differing:
        raise DatasetError(
            f"{folder} holds a dataset with {'; '.join(differing)}: "
            "choose another data_dir, or give overwrite=true to replace it"
        )
    return manifest


def _build(run: Run, workplace: Workplace) -> Manifest:
    try:
        workplace.prepare(run.dataset)
        shards = ordered_map(make_shard, _jobs(run.dataset, workplace), run.options.workers)
        done = tracked(
            ((shard.labyrinths, shard) for shard in shards),
            "build",
            total=run.dataset.labyrinths * len(SPLITS),
        )
        places = list(SPLITS)
        in_order = sorted(done, key=lambda s: (places.index(s.split), len(s.path), s.path))
        labyrinths = _tabulate(run.dataset, workplace, in_order)
        manifest = Manifest(run.dataset, current_versions(), tuple(in_order), labyrinths)
        workplace.commit(manifest)
    except ConfigError:  # The sampler found too few, so the shards are of no use.
        workplace.clear()
        raise
    except OSError as error:
        if not workplace.abandon():
            building = workplace.building
            reason = f"{error}; finished shards are kept in {building} for the next run"
            raise DatasetError(reason) from error
        raise
    except BaseException:
        workplace.abandon()
        raise
    return manifest


def _tabulate(config: DatasetConfig, workplace: Workplace, shards: list[Shard]) -> TableFile:
    """Write the table of labyrinths, from what lies beside the shards' sidecars."""
    parts = (
        (shard, read_facts(facts_path(workplace.building, shard.path), shard.labyrinths))
        for shard in shards
    )
    with new_file(workplace.shards / TABLE, workplace.building) as path:
        return write_table(path, config, parts)


def _jobs(config: DatasetConfig, workplace: Workplace) -> Iterator[ShardJob]:
    """Yield the jobs that a list of structures is for, as soon as it has been sampled."""
    size = max(1, CELLS_PER_SHARD // (config.height * config.width))
    count = -(-config.labyrinths // size)
    made_of = {split: [split] for split in SAMPLED_SPLITS}
    made_of["train"] += [split for split in SPLITS if split not in SAMPLED_SPLITS]
    first = dict.fromkeys(SAMPLED_SPLITS, 0)
    structures: dict[str, list[Structure]] = {split: [] for split in SAMPLED_SPLITS}
    for sampled, structure in stream(config):
        part = structures[sampled]
        part.append(structure)
        if len(part) < min(size, config.labyrinths - first[sampled]):
            continue
        for split in made_of[sampled]:
            name = f"{split}-{first[sampled] // size:05d}-of-{count:05d}"
            path = workplace.shards / f"{name}.parquet"
            sidecar = workplace.building / f"{name}.json"
            facts = facts_path(workplace.building, path.name)
            yield ShardJob(config, split, first[sampled], part, path, sidecar, facts)
        first[sampled] += len(part)
        structures[sampled] = []


def make_shard(job: ShardJob) -> Shard:
    """Make the shard of a job, or return the one that an earlier run has finished."""
    with suppress(FileNotFoundError, ValueError, AttributeError):
        finished = Shard.from_json(json.loads(job.sidecar.read_bytes()))
        read_facts(job.facts, finished.labyrinths)
        if file_sha256(job.path) == finished.sha256:
            return finished
    config, split, cut = job.config, job.split, 0
    facts = FactsOfShard(split)

    def labyrinths() -> Iterator[Labyrinth]:
        for structure in job.structures:
            labyrinth, parent = labyrinth_and_parent(config, split, structure)
            facts.add_parent(parent, of=labyrinth)
            yield labyrinth

    def episodes() -> Iterator[list[Row]]:
        nonlocal cut
        count = max(1, CELLS_PER_BATCH // (config.height * config.width))
        solutions = batched(solve(config, split, batched(labyrinths(), count)), count)
        for number, solution in enumerate(solutions, start=job.first):
            cut += solution.cut
            info = ""
            for rows in render(split, number, solution.episodes):
                info = rows[0].info
                yield rows
            of, actions = solution.episodes[0].labyrinth, [e.actions for e in solution.episodes]
            facts.add(of, info, solution.shortest, actions)

    with new_file(job.path, job.sidecar.parent) as path:
        shard = write(path, split, len(job.structures), episodes())
    shard = replace(shard, cut=cut)
    write_bytes(job.facts, facts.array().tobytes())
    write_text(job.sidecar, json.dumps(asdict(shard)))
    return shard


def batched(items: Iterable[Item], count: int) -> Iterator[Item]:
    """Yield the items, made `count` at a time.

    Between two stages this keeps the processor at one kind of work for longer, which is faster.
    """
    iterator = iter(items)
    while batch := list(islice(iterator, count)):
        yield from batch


def _report_cut(manifest: Manifest) -> None:
    cut = {split: sum(shard.cut for shard in manifest.of(split)) for split in SPLITS}
    named = ", ".join(f"{count} of {split}" for split, count in cut.items() if count)
    if named:
        limit = manifest.config.solutions_limit
        console.print(f"solutions_limit={limit} left out routes of labyrinths: {named}.")

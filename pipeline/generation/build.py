"""The stage `build`: from candidates to structures, to shards, to a dataset.

Workers draw candidates in chunks. This process picks the structures of each split from them, by
their ids, and plans the shards. Workers make the shards. Last, this process writes the table of
labyrinths and the manifest.

A finished shard is not made again: a stopped build resumes, parts are joined, and a finished
dataset grows or is repaired.

A local dataset is built in `.NAME.building` beside its final folder, and moved there once finished.
In an object store, which cannot rename, shards are uploaded under their final names, and the
manifest makes them a dataset.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.box import SIMPLE_HEAD
from rich.table import Table

from labyrinth_core.data import SPLITS, Dataset, DatasetConfig, Drawing, Manifest, Shard
from labyrinth_core.errors import DatasetError
from labyrinth_core.folders import WholeFolder
from labyrinth_core.storage import AnyPath, File
from pipeline.config import ConfigError, Job
from pipeline.generation.labyrinths import Records
from pipeline.generation.options import BuildOptions
from pipeline.generation.shard import (
    ShardJob,
    ShardThere,
    Sidecar,
    finished,
    make_shard,
    not_as_it_was,
)
from pipeline.generation.structures import Candidates, Chunk, check_capacity, draw_chunk, sample
from pipeline.generation.table import structures_in, write_table
from pipeline.generation.workplace import Workplace
from pipeline.inspection import front_matter
from pipeline.machinery import count, held, ordered_map, say, tracked

CELLS_PER_SHARD = 400_000
"""The cells of all labyrinths in a shard: 16,000 labyrinths at 5x5, tens of megabytes."""


def run(job: Job[BuildOptions], **sizes: Any) -> None:
    """Build the dataset of a job, or a part of it, or complete a finished dataset.

    This makes its damaged or missing files again, or adds the labyrinths and shifts to grow by.

    Args:
        job: The options, and the dataset to make.
        sizes: As for `build`.

    Raises:
        ConfigError: There are too few labyrinths.
        DatasetError: The folder holds another dataset or other files, or a damaged file cannot be
            made again with the same bytes.
        OSError: The folder cannot be written.
    """
    manifest = build(job, **sizes)
    if manifest is None:
        return
    with held(job.data_dir, "README.md"):
        front_matter.update(job.data_dir)
    say(_summary(manifest))
    splits = manifest.config.splits
    cut = {split: sum(shard.cut for shard in manifest.of(split)) for split in splits}
    if named := ", ".join(f"{number} of {split}" for split, number in cut.items() if number):
        limit = manifest.config.solutions_limit
        say(f"solutions_limit={limit} was reached, so routes may be missing: {named}.")
    folder = str(job.data_dir)
    # `datasets` reads these as patterns, variables and chains of URLs, and finds no file.
    is_strange = re.search(r"[*?$]|\[.*\]|::", str(job.data_dir.absolute())) is not None
    load = "load_transitions" if is_strange or "://" in folder else "load_dataset"
    say(f"To load it: {load}({folder!r}, {job.dataset.name!r})")


def build(
    job: Job[BuildOptions],
    *,
    cells_per_shard: int = CELLS_PER_SHARD,
    cells_per_chunk: tuple[int, int] = Drawing.CELLS_PER_CHUNK,
) -> Manifest | None:
    """Build as `run` does, without the summary, and return the manifest, or None for a part.

    Args:
        job: The options, and the dataset to make.
        cells_per_shard: The cells of all labyrinths in a shard, which has at least one labyrinth.
        cells_per_chunk: The cells of all candidates in the first chunk and in any other; each has
            at least one candidate.
    """
    work = Build(job, Workplace.of(job.folder), cells_per_shard, cells_per_chunk)
    workplace = work.workplace
    with held(job.data_dir, job.dataset.name):
        workplace.recover()
        existing = None if job.options.overwrite else _existing(job)
        if existing is not None and existing.manifest.config == job.dataset:
            try:
                work.mend(existing)
            finally:  # Another job, with other options, may have been stopped here.
                if workplace.is_for(job.dataset) or not workplace.has_begun:
                    workplace.clear()
            return existing.manifest if job.options.numbers is None else None
        check_capacity(job.dataset)
        workplace.refuse_others_files()
        front_matter.read(job.data_dir / "README.md")  # Raises if it is another user's file.
        if job.options.numbers is None:
            return work.whole(existing)
        part, parts = job.options.numbers
        recount = job.options.overwrite and workplace.is_for(job.dataset)
        workplace.prepare(job.dataset, parts=parts, overwrite=recount)
    # Each part has its own lock, because parts are made at the same time.
    with held(job.data_dir, f"{job.dataset.name}.part-{part}-of-{parts}") as is_locked:
        jobs = work.plan(existing)[0][part % parts :: parts]
        if is_locked:
            workplace.tidy({name for job in jobs for name in (job.path.name, job.sidecar.name)})
        shards = work.made(jobs)
    say(
        f"part={part}/{parts} of {job.folder} is finished, {count(len(shards), 'shard')}: when all "
        "parts are, run the same command without part to join them."
    )
    return None


def _existing(job: Job[BuildOptions]) -> Dataset | None:
    """Return the dataset in the folder of a job, None if there is none.

    The dataset has the same options; or it has fewer labyrinths or shifts, and grows. A dataset in
    an object store, where files are not replaced all at once, cannot grow.
    """
    folder = job.folder
    if not (folder / Manifest.FILE).is_file():
        return None
    data = Dataset.at(folder, renamed=True)  # The message below names what differs.
    old, asked = data.manifest.config, job.dataset
    differing = "; ".join(
        f"{old.given(each.name)}, not {asked.given(each.name)}"
        for each in fields(old)
        if getattr(old, each.name) != getattr(asked, each.name)
    )
    same = replace(old, labyrinths=asked.labyrinths, shifts=asked.shifts) == asked
    more = old.labyrinths <= asked.labyrinths and {*old.shifts} <= {*asked.shifts}
    can_grow = same and more and WholeFolder.of(folder, Manifest.FILE).is_replaced_at_once
    if differing and can_grow and not job.options.grow:
        raise DatasetError(
            f"{folder} holds a finished dataset with {differing}: give grow=true to extend it, or "
            f"another data_dir{_what_refers_to(data.manifest, job)}"
        )
    if differing and same and not more and job.options.grow:
        shifts = ",".join(shift for shift in SPLITS.shifts if shift in {*old.shifts, *asked.shifts})
        raise DatasetError(
            f"{folder} holds a dataset with {differing}: to extend it, give all it is to have, "
            f"labyrinths={max(old.labyrinths, asked.labyrinths)} 'shifts=[{shifts}]'"
        )
    if differing and not can_grow:
        raise DatasetError(
            f"{folder} holds a dataset with {differing}: "
            "choose another data_dir, or give overwrite=true to replace it"
        )
    return data


def _what_refers_to(manifest: Manifest, job: Job[BuildOptions]) -> str:
    """Return a clause that names runs and results of a dataset, found by its fingerprint."""
    folders = Path(job.options.run_dir) / manifest.config.name, Path(job.options.results_dir)
    files = chain.from_iterable(folder.expanduser().rglob("*.json") for folder in folders)
    mark = manifest.fingerprint.encode()
    referring = [str(path) for path in files if path.is_file() and mark in path.read_bytes()]
    more = f" and {len(referring) - 2} more" if len(referring) > 2 else ""
    refers = f"{', '.join(sorted(referring)[:2])}{more} would refer to a dataset that is gone"
    return f"; {refers}" if referring else ""


@dataclass(frozen=True)
class Build:
    """The work of making the dataset of a job."""

    job: Job[BuildOptions]
    workplace: Workplace
    cells_per_shard: int
    cells_per_chunk: tuple[int, int]

    def plan(self, existing: Dataset | None = None) -> tuple[list[ShardJob], bool]:
        """Return the jobs of all shards, in the manifest's order, and whether one chunk was enough.

        Workers draw the candidates if there are many.

        Args:
            existing: The dataset in the same folder if it grows, else None.

        Raises:
            ConfigError: There are too few labyrinths.
            DatasetError: The dataset cannot grow.
        """
        config, building = self.job.dataset, self.workplace.building
        candidates = Candidates(config, self._draw, cells=self.cells_per_chunk)
        sampled = sample(config, candidates)
        size = max(1, self.cells_per_shard // (config.height * config.width))
        shards = -(-config.labyrinths // size)
        reusable = {} if existing is None else _shards_there(existing, sampled.structures)
        jobs = []
        for split in config.splits:
            of_split = sampled.structures[SPLITS[split].parent or split]
            for first in range(0, config.labyrinths, size):
                structures = of_split[first : first + size]
                name = f"{split}-{first // size:05d}-of-{shards:05d}.parquet"
                reused = reusable.get((split, structures["id"].tobytes()))
                path = self.workplace.shards / name
                jobs.append(ShardJob(config, split, first, structures, path, building, reused))
        if existing is not None:
            stay = sum(job.there is not None for job in jobs)
            say(f"{self.job.folder} grows: {stay} of {count(len(jobs), 'shard')} stay.")
        return jobs, sampled.candidates <= candidates.first.size

    def _draw(self, chunks: Sequence[Chunk]) -> Iterator[Records]:
        """Draw chunks of candidates by workers, and yield their records."""
        building, options = self.workplace.building, self.job.options
        jobs = [(chunk, building) for chunk in chunks]
        if options.numbers is not None:  # A part draws its own first, then those still missing.
            part, parts = options.numbers
            own = len(jobs) * (part - 1) // parts
            jobs = jobs[own:] + jobs[:own]
        drawn = ordered_map(draw_chunk, jobs, options.workers)
        for _ in tracked(drawn, "draw", len(jobs)):
            pass
        return (chunk.read(building) for chunk in chunks)

    def whole(self, existing: Dataset | None) -> Manifest:
        """Build the whole dataset, from its parts if it has any, and return its manifest."""
        config, workplace = self.job.dataset, self.workplace
        try:
            workplace.prepare(config, overwrite=self.job.options.overwrite)
            jobs, in_one_chunk = self.plan(existing)
            shards = self._joined(jobs) if workplace.parts else self.made(jobs)
            _check_shifts(config, shards)
            manifest = Manifest.of_build(config, shards, in_one_chunk=in_one_chunk)
            manifest = self._tabulate(workplace.shards, jobs, manifest)
            workplace.commit(manifest)
        except ConfigError:  # There are too few labyrinths, so the shards are of no use.
            workplace.clear()
            raise
        except OSError as error:
            if workplace.abandon():
                raise
            kept = f"finished shards are kept in {workplace.building} for the next run"
            raise DatasetError(f"{error}; {kept}") from error
        except BaseException:
            workplace.abandon()
            raise
        return manifest

    def mend(self, data: Dataset) -> None:
        """Make the damaged and missing files of a finished dataset again, and say which."""
        folder, manifest = self.job.folder, data.manifest
        lacks = self.workplace.lacks(manifest)
        if not lacks:
            say(f"{folder} is complete already.")
            return
        # The table is made from the facts of all shards.
        again = {
            shard.path: ShardThere(self.workplace.folder / shard.path, shard)
            for shard in manifest.shards
            if shard.path in lacks or Manifest.TABLE in lacks
        }
        self.workplace.begin(self.job.dataset)
        jobs = [
            replace(job, path=old.path, there=old)
            for job in self.plan()[0]
            if (old := again.get(job.path.name))
        ]
        made = {shard.path for shard in self.made(jobs)}
        if missing := [name for name in again if name not in made]:
            raise DatasetError(not_as_it_was(folder / missing[0]))
        if Manifest.TABLE in lacks:
            self._tabulate(folder, jobs, manifest)
        say(f"{folder} is complete again; repaired: {', '.join(lacks)}.")

    def made(self, jobs: Sequence[ShardJob]) -> tuple[Shard, ...]:
        """Make the shards of jobs by workers."""
        made = ordered_map(make_shard, jobs, self.job.options.workers)
        total = sum(len(job.structures) for job in jobs)
        return tuple(tracked(made, "build", total, lambda shard: shard.labyrinths))

    def _joined(self, jobs: Sequence[ShardJob]) -> tuple[Shard, ...]:
        """Return the shards that parts have finished; raise DatasetError if one is missing."""
        parts = self.workplace.parts or 1
        shards = list(ordered_map(finished, jobs, self.job.options.workers))
        missing = [number for number, shard in enumerate(shards) if shard is None]
        if missing:
            of = list(dict.fromkeys(f"{number % parts or parts}/{parts}" for number in missing))
            more = f" and {len(of) - 8} others" if len(of) > 8 else ""
            raise DatasetError(
                f"{self.job.folder}: {len(missing)} of {count(len(jobs), 'shard')} missing, those "
                f"of part {', '.join(of[:8])}{more}; this command with part={of[0]} makes the "
                "first of them"
            )
        return tuple(shard for shard in shards if shard is not None)

    def _tabulate(self, folder: AnyPath, jobs: Sequence[ShardJob], manifest: Manifest) -> Manifest:
        """Write the table of labyrinths from the sidecars of the shards.

        Args:
            folder: The folder of the table.
            jobs: The jobs of all shards, which are finished, in their order.
            manifest: The manifest. If it has a table, another one raises a DatasetError and is not
                written.

        Returns:
            The manifest with the table.
        """
        with File(folder / Manifest.TABLE).replacing(self.workplace.building) as path:
            sidecars = map(Sidecar.read, jobs)
            parts = ((sidecar.shard, sidecar.facts) for sidecar in sidecars)
            write_table(path, self.job.dataset, parts)
            made = manifest.with_table(path)
            if manifest.labyrinths is not None and made != manifest:
                raise DatasetError(not_as_it_was(folder / Manifest.TABLE))
            return made


def _shards_there(
    data: Dataset, structures: Mapping[str, Records]
) -> dict[tuple[str, bytes], ShardThere]:
    """Return the shards of the dataset that grows, by their split and the ids of their structures.

    A split with a parent has the structures of the parent. No shard is returned if the dataset was
    built with other versions of libraries, which may give other bytes.

    Args:
        data: The shorter dataset.
        structures: The structures of the longer dataset, for each split that has its own.

    Raises:
        DatasetError: The longer dataset would lack labyrinths of the shorter one, or the table of
            the shorter one is missing or damaged.
    """
    ids, row = structures_in(data), 0
    by_structures: dict[tuple[str, bytes], ShardThere] = {}
    of_shards: dict[str, list[NDArray[np.int64]]] = {}
    for split in data.manifest.config.splits:
        own, begin = of_shards.setdefault(split, []), row
        for file in data.files(split):
            end = row + file.shard.labyrinths
            own.append(ids[row:end])
            of_parent = of_shards[SPLITS[split].parent or split][len(own) - 1]
            by_structures[split, of_parent.tobytes()] = ShardThere(file.path, file.shard, row)
            row = end
        if SPLITS[split].parent is None:
            longer = structures[split]["id"]
            if not np.array_equal(ids[begin:row], longer[: row - begin]):
                raise DatasetError(
                    f"{data.folder} holds labyrinths that are not in the dataset with more "
                    "labyrinths or shifts: choose another data_dir, or give overwrite=true"
                )
    return by_structures if data.manifest.is_of_current_versions else {}


def _check_shifts(config: DatasetConfig, shards: Sequence[Shard]) -> None:
    """Raise ConfigError if a shift has no labyrinth at all; single shards may be empty."""
    for shift in config.shifts:
        if not any(shard.labyrinths for shard in shards if shard.split == shift):
            parents = f"{config.labyrinths} labyrinths of {SPLITS[shift].parent}"
            raise ConfigError(
                f"shifts: {shift} cannot be made from any of {parents}; ask for more labyrinths, "
                f"or leave {shift} out"
            )


def _summary(manifest: Manifest) -> Table:
    """Return the table of a dataset, with a row of figures for each split."""
    title = f"{manifest.config.name}, seed {manifest.config.seed}"
    table = Table(title=title, box=SIMPLE_HEAD, collapse_padding=True, pad_edge=False)
    table.add_column("split")
    for heading in ("labyrinths", "episodes", "rows", "mean moves", "longest", "MB"):
        table.add_column(heading, justify="right")
    for split in manifest.config.splits:
        shards = manifest.of(split)
        episodes, rows = sum(s.episodes for s in shards), sum(s.rows for s in shards)
        table.add_row(
            split,
            f"{sum(s.labyrinths for s in shards):,}",
            f"{episodes:,}",
            f"{rows:,}",
            f"{(rows - episodes) / episodes:.2f}",
            f"{max(s.longest for s in shards):,}",
            f"{sum(s.bytes for s in shards) / 1e6:.2f}",
        )
    return table

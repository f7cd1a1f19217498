"""The build: from candidates to structures, to shards, to a dataset; the manifest comes last.

Workers draw candidates in chunks. This process takes the structures of each split from them, by
their ids, and plans the shards. Workers make a shard each. At last the shards get their table and
their manifest.

A local dataset is built in `.NAME.building` beside its final folder, and moved there once finished.
In an object store, which cannot rename, shards are uploaded under their final names, and the
manifest makes them a dataset. Either way each finished shard has a sidecar in `.NAME.building`,
from which a build that was stopped goes on.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import fields, replace
from functools import partial
from itertools import chain
from pathlib import Path

from labyrinth_core.data.dataset_config import DatasetConfig
from labyrinth_core.data.errors import DatasetError
from labyrinth_core.data.labyrinth_table import TABLE
from labyrinth_core.data.manifest import MANIFEST, Manifest, Shard, TableFile
from labyrinth_core.data.splits import SPLITS
from labyrinth_core.data.storage import AnyPath, RemotePath
from pipeline.config.errors import ConfigError
from pipeline.config.run import Run
from pipeline.generation.candidates import CELLS_PER_CHUNK
from pipeline.generation.plan import Plan, plan_shards
from pipeline.generation.sample import check_capacity
from pipeline.generation.shards import ShardJob, finished_shard, make_shard, not_as_it_was
from pipeline.generation.tabulate import read_facts, write_table
from pipeline.generation.workplace import Workplace
from pipeline.inspection import front_matter
from pipeline.machinery.artifact import is_litter
from pipeline.machinery.console import console, say, summary, tracked
from pipeline.machinery.dataset import current_versions
from pipeline.machinery.executor import ordered_map
from pipeline.machinery.folders import held, new_file
from pipeline.machinery.markdown import count

CELLS_PER_SHARD = 400_000
"""The cells of all labyrinths in a shard: 16,000 labyrinths at 5x5, some tens of megabytes."""


def run(
    run: Run,
    *,
    cells_per_shard: int = CELLS_PER_SHARD,
    cells_per_chunk: tuple[int, int] = CELLS_PER_CHUNK,
) -> None:
    """Build the dataset of a run, or a part of it, or what a finished one lacks.

    A finished dataset lacks what is damaged or missing, or the labyrinths and shifts to grow by.

    Args:
        run: The run.
        cells_per_shard: The cells of all labyrinths in a shard; at least one labyrinth is in it.
        cells_per_chunk: The cells of all candidates in the first chunk and in any other; at least
            one candidate is in each.

    Raises:
        ConfigError: There are fewer labyrinths than asked for.
        DatasetError: The folder holds another dataset or other files, or a damaged file cannot be
            made again as it was.
        OSError: The folder cannot be written.
    """
    if run.part is not None:
        workplace = Workplace.of(run.folder)
        _run_part(
            run, workplace, partial(plan_shards, run, workplace, cells_per_shard, cells_per_chunk)
        )
        return
    manifest = build(run, cells_per_shard=cells_per_shard, cells_per_chunk=cells_per_chunk)
    with held(run.data_dir, "README.md"):
        front_matter.update(run.data_dir)
    console.print(summary(manifest))
    _report_cut(manifest)
    say(f"To load it: {_loading_line(run)}")


def build(
    run: Run,
    *,
    cells_per_shard: int = CELLS_PER_SHARD,
    cells_per_chunk: tuple[int, int] = CELLS_PER_CHUNK,
) -> Manifest:
    """Make the whole dataset of a run as `run` does, print none of its options, and return it."""
    workplace = Workplace.of(run.folder)
    plan_of = partial(plan_shards, run, workplace, cells_per_shard, cells_per_chunk)
    with held(run.data_dir, run.dataset.name):
        workplace.recover()
        manifest = None if run.options.overwrite else _there(run)
        if manifest is not None and manifest.config == run.dataset:
            try:
                _mend(run, workplace, manifest, plan_of)
            finally:
                # Another run, with other options, may have been stopped here.
                if workplace.is_for(run.dataset) or not workplace.has_begun:
                    workplace.clear()
        else:
            _check(run, workplace)
            manifest = _build(run, workplace, partial(plan_of, shorter=manifest))
    return manifest


def _check(run: Run, workplace: Workplace) -> None:
    """Raise an error if a build would be refused or fail in the end."""
    check_capacity(run.dataset)
    workplace.refuse_others_files()
    front_matter.read(run.data_dir / "README.md")  # Raises if it is another user's file.


def _there(run: Run) -> Manifest | None:
    """Return the manifest of the dataset in the folder of a run, None if it has none.

    It was built with the same options, or with fewer labyrinths or shifts and is to grow. In an
    object store, where files are not replaced all at once, it cannot.
    """
    folder = run.folder
    if not (folder / MANIFEST).is_file():
        unfinished = isinstance(folder, RemotePath) and Workplace(folder).has_begun
        others = [] if unfinished or not folder.exists() else [*folder.iterdir()]
        if not all(is_litter(path.name) for path in others):
            raise DatasetError(
                f"{folder} holds files but no finished dataset: move them, or choose another "
                "data_dir"
            )
        return None
    manifest = Manifest.read(folder)
    there, asked = manifest.config, run.dataset
    differing = "; ".join(
        f"{there.given(each.name)}, not {asked.given(each.name)}"
        for each in fields(there)
        if getattr(there, each.name) != getattr(asked, each.name)
    )
    same = replace(there, labyrinths=asked.labyrinths, shifts=asked.shifts) == asked
    more = there.labyrinths <= asked.labyrinths and {*there.shifts} <= {*asked.shifts}
    can_grow = same and more and isinstance(folder, Path)
    if differing and can_grow and not run.options.grow:
        raise DatasetError(
            f"{folder} holds a finished dataset with {differing}: give grow=true to extend it, or "
            f"another data_dir; {_what_refers_to(manifest, run)}"
        )
    if differing and not can_grow:
        raise DatasetError(
            f"{folder} holds a dataset with {differing}: "
            "choose another data_dir, or give overwrite=true to replace it"
        )
    return manifest


def _what_refers_to(manifest: Manifest, run: Run) -> str:
    """Return which runs and results on this machine are of a dataset, by its fingerprint."""
    folders = Path(run.options.run_dir) / manifest.config.name, Path(run.options.results_dir)
    files = chain.from_iterable(folder.expanduser().rglob("*.json") for folder in folders)
    mark = manifest.fingerprint.encode()
    found = [str(path) for path in files if path.is_file() and mark in path.read_bytes()]
    named = ", ".join(sorted(found)[:2]) or "runs and results"
    more = f" and {len(found) - 2} more" if len(found) > 2 else ""
    return f"{named}{more} of the dataset as it is would refer to one that is gone"


def _mend(run: Run, workplace: Workplace, manifest: Manifest, plan_of: Callable[[], Plan]) -> None:
    """Make the damaged and the missing shards of a finished dataset anew, and say which."""
    damaged, has_table = workplace.damaged(manifest), workplace.has_table(manifest)
    if not damaged and has_table:
        say(f"{run.folder} is complete already.")
        return
    # The table follows from what all shards were made of.
    again = damaged if has_table else manifest.shards
    expected = {shard.path: shard.sha256 for shard in again}
    workplace.begin(run.dataset)
    plan = plan_of()
    jobs = [
        replace(job, path=workplace.folder / name, expected=expected[name])
        for job in plan.jobs
        if (name := job.path.name) in expected
    ]
    made = {shard.path for shard in _made(run, jobs)}
    if missing := [name for name in expected if name not in made]:
        raise DatasetError(not_as_it_was(run.folder / missing[0]))
    names = [shard.path for shard in damaged]
    if not has_table:
        names.append(TABLE)
        _tabulate(manifest.config, workplace, run.folder, manifest.shards, manifest.labyrinths)
    say(f"{run.folder} is complete again: made anew, as damaged or missing: {', '.join(names)}.")


def _build(run: Run, workplace: Workplace, plan_of: Callable[[], Plan]) -> Manifest:
    try:
        workplace.prepare(run.dataset, overwrite=run.options.overwrite)
        plan = plan_of()
        parts = workplace.parts
        shards = _joined(run, plan.jobs, parts) if parts else _made(run, plan.jobs)
        _check_shifts(run.dataset, shards)
        labyrinths = _tabulate(run.dataset, workplace, workplace.shards, shards)
        manifest = Manifest(run.dataset, current_versions(), shards, labyrinths, plan.format)
        workplace.commit(manifest)
    except ConfigError:  # There are too few labyrinths, so the shards are of no use.
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


def _made(run: Run, jobs: Sequence[ShardJob]) -> tuple[Shard, ...]:
    made = ordered_map(make_shard, jobs, run.options.workers)
    total = sum(len(job.structures) for job in jobs)
    return tuple(tracked(((shard.labyrinths, shard) for shard in made), "build", total=total))


def _run_part(run: Run, workplace: Workplace, plan_of: Callable[..., Plan]) -> None:
    """Make the shards of a part: those whose numbers leave its number on division by all parts."""
    part, parts = run.part or (1, 1)
    with held(run.data_dir, run.dataset.name):
        manifest = None if run.options.overwrite else _there(run)
        if manifest is not None and manifest.config == run.dataset:
            say(f"{run.folder} is complete already.")
            return
        _check(run, workplace)
        workplace.prepare(run.dataset, parts=parts)
    # Under a name of its own, since parts are made at the same time.
    with held(run.data_dir, f"{run.dataset.name}.part-{part}-of-{parts}"):
        shards = _made(run, plan_of(shorter=manifest).jobs[part % parts :: parts])
    say(
        f"part={part}/{parts} of {run.folder} is finished, {count(len(shards), 'shard')}: when all "
        "parts are, the same command without part makes the dataset of them."
    )


def _joined(run: Run, jobs: Sequence[ShardJob], parts: int) -> tuple[Shard, ...]:
    """Return the shards that parts have finished; raise DatasetError if one is missing."""
    found = list(ordered_map(finished_shard, jobs, run.options.workers))
    missing = [number for number, shard in enumerate(found) if shard is None]
    if missing:
        of = list(dict.fromkeys(f"{number % parts or parts}/{parts}" for number in missing))
        more = f" and {len(of) - 8} others" if len(of) > 8 else ""
        raise DatasetError(
            f"{run.folder}: {len(missing)} of {count(len(jobs), 'shard')} missing, those of part "
            f"{', '.join(of[:8])}{more}; this command with part={of[0]} makes the first of them"
        )
    return tuple(shard for shard in found if shard is not None)


def _check_shifts(config: DatasetConfig, shards: Sequence[Shard]) -> None:
    """Raise ConfigError if a shift has no labyrinth at all; one of its shards may have none."""
    for shift in config.shifts:
        if not any(shard.labyrinths for shard in shards if shard.split == shift):
            parents = f"{config.labyrinths} labyrinths of {SPLITS[shift].parent}"
            raise ConfigError(
                f"shifts: there is no {shift} of any of {parents}; ask for more labyrinths, or "
                f"leave {shift} out"
            )


def _tabulate(
    config: DatasetConfig,
    workplace: Workplace,
    folder: AnyPath,
    shards: Sequence[Shard],
    expected: TableFile | None = None,
) -> TableFile:
    """Write the table of labyrinths, from what lies beside the shards' sidecars.

    Args:
        config: The configuration of the dataset.
        workplace: Where it is built.
        folder: Where the table is to be.
        shards: The shards, in their order.
        expected: The table that has to be written, if it is known already.

    Raises:
        DatasetError: Another table comes out; it is not written.
    """
    parts = ((shard, read_facts(workplace.building, shard)) for shard in shards)
    with new_file(folder / TABLE, workplace.building) as path:
        written = write_table(path, config, parts)
        if expected not in (None, written):
            raise DatasetError(not_as_it_was(folder / TABLE))
        return written


def _loading_line(run: Run) -> str:
    """Return the line of Python that loads the dataset of a run."""
    place = str(run.data_dir)
    whole = str(run.data_dir.absolute()) if isinstance(run.data_dir, Path) else place
    # `datasets` takes these for patterns, variables and chains of URLs, and finds no file.
    is_strange = re.search(r"[*?$]|\[.*\]|::", whole) is not None
    load = "load_transitions" if is_strange or "://" in place else "load_dataset"
    return f"{load}({place!r}, {run.dataset.name!r})"


def _report_cut(manifest: Manifest) -> None:
    splits = manifest.config.splits
    cut = {split: sum(shard.cut for shard in manifest.of(split)) for split in splits}
    named = ", ".join(f"{count} of {split}" for split, count in cut.items() if count)
    if named:
        limit = manifest.config.solutions_limit
        console.print(f"solutions_limit={limit} left out routes of labyrinths: {named}.")

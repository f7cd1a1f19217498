"""The validation of a finished dataset: each row is replayed, and the splits are compared.

`check` goes through the rows of one shard, and compares what they say with the table of labyrinths
and, in a shift, with the labyrinths of its parent. Here shards are compared: no structure is in two
splits, those of random, s0 and s0_and_g are in train, and there are as many labyrinths as wanted.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress

import numpy as np

from labyrinth_core.data.errors import DatasetError
from labyrinth_core.data.labyrinth_table import TABLE
from labyrinth_core.data.manifest import Manifest, Shard, current_versions
from labyrinth_core.data.source import read_rows
from labyrinth_core.data.splits import BASE_SPLITS, SAMPLED_SPLITS, SPLITS, is_selected
from labyrinth_core.data.storage import AnyPath
from labyrinth_core.language.text import parse, without_agent
from labyrinth_core.world.route_memory import RouteMemory
from pipeline.config.run import Run
from pipeline.generation.check import CheckJob, ShardReport, check_shard
from pipeline.generation.check_table import table_file_problems, table_parts
from pipeline.generation.extremes import NO_EXTREMES, extremes_of
from pipeline.inspection.routes import routes_of
from pipeline.machinery.console import say, tracked
from pipeline.machinery.executor import ordered_map

PROBLEMS_SHOWN = 20


class ValidationError(DatasetError):
    """A dataset that is not valid; `problems` has one line for each reason."""

    def __init__(self, folder: AnyPath, problems: list[str]) -> None:
        self.problems = problems
        shown = problems[:PROBLEMS_SHOWN]
        more = len(problems) - len(shown)
        lines = [f"{folder} is not valid:", *shown, *([f"and {more} more"] if more else [])]
        super().__init__("\n  ".join(lines))


def run(run: Run) -> None:
    """Validate the dataset in the folder of a run.

    Raises:
        ValidationError: Rows are wrong; the message names file, row and field.
        DatasetError: There is no dataset.
    """
    manifest = Manifest.read(run.folder)
    problems = validate(run.folder, manifest, run.options.workers)
    if problems:
        raise ValidationError(run.folder, problems)
    rows = sum(shard.rows for shard in manifest.shards)
    say(f"{run.folder} is valid: {rows:,} rows replayed.")
    for shift in manifest.config.shifts:
        held = sum(shard.labyrinths for shard in manifest.of(shift))
        say(f"  {shift}, {held:,} labyrinths: {SPLITS[shift].meaning}")


def validate(folder: AnyPath, manifest: Manifest, workers: int = 1) -> list[str]:
    """Return what is wrong with a dataset, one line for each problem.

    Args:
        folder: The folder of the shards.
        manifest: The manifest of the dataset.
        workers: The number of processes.
    """
    problems, comparable = table_file_problems(folder, manifest)
    jobs = list(_jobs(folder, manifest, comparable))
    reports = tracked(
        ((report.shard.rows, report) for report in ordered_map(check_shard, jobs, workers)),
        "validate",
        total=sum(shard.rows for shard in manifest.shards),
    )
    listed = {shard.path for shard in manifest.shards}
    if manifest.labyrinths is not None:
        listed.add(TABLE)
    unlisted = {path.name for path in folder.glob("*.parquet")} - listed
    problems += [f"{name} is not in the manifest" for name in sorted(unlisted)]
    owners = Owners()
    for report in reports:
        problems += report.problems
        problems += owners.misplaced(report)
    if not owners.know_train:
        problems.append("structures are not looked up in train, of which some are missing")
    return problems + list(_miscounted(manifest))


def _miscounted(manifest: Manifest) -> Iterator[str]:
    """Yield the splits that hold too few or too many labyrinths or shards."""
    shards_of, wanted = _shards_of(manifest), manifest.config.labyrinths
    for split, shards in shards_of.items():
        count, parent = sum(shard.labyrinths for shard in shards), SPLITS[split].parent
        # A shift leaves out what has no such variant; the check of the shard looks for these.
        short = split not in BASE_SPLITS and parent is not None and 0 < count < wanted
        if count != wanted and not short:
            yield f"{split} holds {count} labyrinths, not {wanted}"
        if parent and len(shards) != (of_parent := len(shards_of[parent])):
            yield f"{split} has {len(shards)} shards, and {parent}, its parent, {of_parent}"


def _shards_of(manifest: Manifest) -> dict[str, list[Shard]]:
    """Return the shards of each split, none where the manifest has lost them."""
    found: dict[str, list[Shard]] = {split: [] for split in manifest.config.splits}
    for shard in manifest.shards:
        found[shard.split].append(shard)
    return found


def _jobs(folder: AnyPath, manifest: Manifest, with_table: bool) -> Iterator[CheckJob]:
    """Yield the job of each shard; the labyrinths of a shift are numbered like their parents."""
    paths = (shard.path for shard in manifest.shards)
    tables = dict(zip(paths, table_parts(manifest), strict=True)) if with_table else {}
    config = manifest.config
    same_bytes = dict(manifest.versions) == current_versions()
    extremes = NO_EXTREMES
    if any(map(is_selected, config.shifts)):
        with suppress(DatasetError, OSError, ValueError):  # The check of the shard says it.
            rows = read_rows(folder, manifest.of("train"), pictures=False)
            extremes = extremes_of(map(parse, {without_agent(row.info): None for row in rows}))
            if "test_new_routes" in config.shifts:
                extremes = extremes._replace(memory=_routes_of_train(folder, manifest))
    shards_of = _shards_of(manifest)
    for split, shards in shards_of.items():
        parent = SPLITS[split].parent
        aligned = parent is not None and split not in BASE_SPLITS
        numbered = shards_of[parent] if aligned and parent else shards
        first = 0
        for shard, of_parent in zip(shards, numbered, strict=False):
            yield CheckJob(
                folder,
                shard,
                config,
                first,
                same_bytes,
                tables.get(shard.path),
                of_parent if aligned else None,
                extremes,
            )
            first += of_parent.labyrinths


def _routes_of_train(folder: AnyPath, manifest: Manifest) -> RouteMemory:
    cells = manifest.config.height * manifest.config.width
    return RouteMemory(
        [state % cells for state in route.states]
        for shard in manifest.of("train")
        for route in routes_of(folder, shard)
    )


class Owners:
    """The first place of each structure, in sixteen bytes each, as there may be millions."""

    def __init__(self) -> None:
        self._ids = np.empty(0, np.int64)
        """Structure ids, sorted, shape (structures,)."""
        self._rows = np.empty(0, np.int64)
        """For each structure, the index of its shard times 2 ** 32, plus the row in it."""
        self._shards: list[Shard] = []
        self.know_train = True
        """Whether there was a structure for each labyrinth of train."""

    def misplaced(self, report: ShardReport) -> Iterator[str]:
        """Yield the structures that are in another split too, or not in train as they should be.

        Args:
            report: The report of the next shard, in the order of the splits.
        """
        split = report.shard.split
        own = split in SAMPLED_SPLITS or is_selected(split)
        if not own and split not in BASE_SPLITS:
            return  # The check of the shard compares it with its parents.
        if split == "train" and len(report.structures) < report.shard.labyrinths:
            self.know_train = False
        ids = np.array([int(each, 16) for each in report.structures], np.int64)
        rows = np.array([*report.structures.values()], np.int64)
        places = np.searchsorted(self._ids, ids)
        known = np.isin(ids, self._ids, assume_unique=True)
        for row, place, is_known in zip(rows.tolist(), places.tolist(), known, strict=True):
            here = f"{report.shard.path} row {row} info: the structure is"
            if not is_known and not own:
                if self.know_train:
                    yield f"{here} not one of train"
            elif is_known:
                number, before = divmod(int(self._rows[place]), 1 << 32)
                shard = self._shards[number]
                if own:
                    yield f"{here} also in {shard.path} row {before}"
                elif shard.split != "train":
                    yield f"{here} not one of train"
        if own:
            order = np.argsort(ids)
            order = order[~known[order]]
            rows = rows + (len(self._shards) << 32)
            self._ids = np.insert(self._ids, places[order], ids[order])
            self._rows = np.insert(self._rows, places[order], rows[order])
            self._shards.append(report.shard)

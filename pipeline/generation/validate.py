"""The validation of a finished dataset: each row is replayed, and the splits are compared.

`check` goes through the rows of one shard, and compares what they say with the table of labyrinths.
Here shards are compared: no structure is in two splits,
those of random, s0 and s0_and_g are in train, and there are as many labyrinths as asked for.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from labyrinth_core.data.columns import SAMPLED_SPLITS, SPLITS
from labyrinth_core.data.errors import DatasetError
from labyrinth_core.data.labyrinth_table import TABLE
from labyrinth_core.data.manifest import Manifest, Shard, current_versions
from labyrinth_core.data.storage import AnyPath
from pipeline.config.run import Run
from pipeline.generation.check import CheckJob, ShardReport, check_shard
from pipeline.generation.check_table import table_file_problems, table_parts
from pipeline.machinery.console import console, tracked
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
    console.print(f"{run.folder} is valid: {rows:,} rows replayed.", highlight=False)


def validate(folder: AnyPath, manifest: Manifest, workers: int = 1) -> list[str]:
    """Return what is wrong with a dataset, one line for each problem.

    Args:
        folder: The folder of the shards.
        manifest: The manifest of the dataset.
        workers: The number of processes.
    """
    jobs = []
    found = dict.fromkeys(SPLITS, 0)
    same_bytes = dict(manifest.versions) == current_versions()
    problems, comparable = table_file_problems(folder, manifest)
    for shard, part in zip(manifest.shards, table_parts(manifest), strict=True):
        first, table = found[shard.split], part if comparable else None
        jobs.append(CheckJob(folder, shard, manifest.config, first, same_bytes, table))
        found[shard.split] += shard.labyrinths
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
    for split, count in found.items():
        if count != manifest.config.labyrinths:
            problems.append(f"{split} holds {count} labyrinths, not {manifest.config.labyrinths}")
    return problems


class Owners:
    """The first place of each structure, in sixteen bytes each, as there may be millions."""

    def __init__(self) -> None:
        self._ids = np.empty(0, np.int64)
        """Structure ids, sorted, shape (structures,)."""
        self._rows = np.empty(0, np.int64)
        """For each structure, the index of its shard times 2 ** 32, plus the row in it."""
        self._shards: list[Shard] = []

    def misplaced(self, report: ShardReport) -> Iterator[str]:
        """Yield the structures that are in another split too, or not in train as they should be.

        Args:
            report: The report of the next shard, in the order of the splits.
        """
        own = report.shard.split in SAMPLED_SPLITS
        ids = np.array([int(each, 16) for each in report.structures], np.int64)
        rows = np.array([*report.structures.values()], np.int64)
        places = np.searchsorted(self._ids, ids)
        known = np.isin(ids, self._ids, assume_unique=True)
        for row, place, is_known in zip(rows.tolist(), places.tolist(), known, strict=True):
            here = f"{report.shard.path} row {row} info: the structure is"
            if not is_known and not own:
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

"""Validation: every row of a finished dataset, replayed, and its splits held against each other.

`check` goes through the rows of a shard; here the shards are put together: no structure in two
splits, those of random, s0 and s0_and_g in train, as many labyrinths as the configuration says.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from pipeline.config import Run
from pipeline.executor import ordered_map
from pipeline.generation.check import CheckJob, ShardReport, check_shard
from pipeline.manifest import DatasetError, Manifest, current_versions
from pipeline.schema import SAMPLED_SPLITS, SPLITS
from pipeline.terminal import console, tracked

PROBLEMS_SHOWN = 20


class ValidationError(DatasetError):
    """A dataset with rows that are not what they should be; `problems` names them."""

    def __init__(self, folder: Path, problems: list[str]) -> None:
        self.problems = problems
        shown = problems[:PROBLEMS_SHOWN]
        more = len(problems) - len(shown)
        lines = [f"{folder} is not valid:", *shown, *([f"and {more} more"] if more else [])]
        super().__init__("\n  ".join(lines))


def run(run: Run) -> None:
    """Validate the dataset in the folder of a run.

    Raises:
        ValidationError: Rows are wrong; it names file, row and field.
        DatasetError: There is no dataset.
    """
    manifest = Manifest.read(run.folder)
    problems = validate(run.folder, manifest, run.workers)
    if problems:
        raise ValidationError(run.folder, problems)
    rows = sum(shard.rows for shard in manifest.shards)
    console.print(f"{run.folder} is valid: {rows:,} rows replayed.", highlight=False)


def validate(folder: Path, manifest: Manifest, workers: int = 1) -> list[str]:
    """Return what is wrong with a dataset, one line for each problem.

    Args:
        folder: With its shards.
        manifest: Of that folder.
        workers: Processes.
    """
    jobs = []
    first: dict[str, int] = {}
    same_bytes = dict(manifest.versions) == current_versions()
    for shard in manifest.shards:
        begin = first.get(shard.split, 0)
        first[shard.split] = begin + shard.labyrinths
        jobs.append(CheckJob(folder, shard, manifest.config, begin, same_bytes))
    reports = tracked(
        ((report.shard.rows, report) for report in ordered_map(check_shard, jobs, workers)),
        "validate",
        total=sum(shard.rows for shard in manifest.shards),
    )
    listed = {shard.path for shard in manifest.shards}
    problems = [
        f"{path.name} is not in the manifest"
        for path in sorted(folder.glob("*.parquet"))
        if path.name not in listed
    ]
    owners: dict[str, str] = {}
    for report in reports:
        problems += report.problems
        problems += _misplaced(report, owners)
    for split in SPLITS:
        labyrinths = first.get(split, 0)
        if labyrinths != manifest.config.labyrinths:
            problems.append(
                f"{split} holds {labyrinths} labyrinths, not {manifest.config.labyrinths}"
            )
    return problems


def _misplaced(report: ShardReport, owners: dict[str, str]) -> Iterator[str]:
    """Yield the structures that came before in another split, or are not of train at all.

    Args:
        report: Of the next shard, in the order of the splits.
        owners: Structure id -> where it was first; filled in here.
    """
    for structure_id, row in report.structures.items():
        here = f"{report.shard.path} row {row}"
        before = owners.get(structure_id)
        if report.shard.split in SAMPLED_SPLITS:
            if before:
                yield f"{here} info: the structure is also in {before}"
            else:
                owners[structure_id] = here
        elif before is None or not before.startswith("train"):
            yield f"{here} info: the structure is not one of train"

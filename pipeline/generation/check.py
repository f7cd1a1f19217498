"""The stage `validate`: make each labyrinth of a finished dataset again, and compare its rows.

The build's functions make the rows from the structure in their text or, in a split with a parent,
from the structures in the parent's shard. The file must hold these rows: byte for byte if the
libraries are those of the manifest, else pixel for pixel. The table of labyrinths must hold the
facts that follow from them. Each labyrinth must keep the rules of its split. No structure may occur
twice in splits without a parent. The number of labyrinths must be the configured one.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import chain, groupby
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.data import COLUMNS, SPLITS, TABLE_COLUMNS, Dataset, Manifest, Shard, ShardFile
from labyrinth_core.errors import DatasetError, one_line
from labyrinth_core.listing import is_litter
from labyrinth_core.storage import AnyPath, File
from pipeline.config import Job, WorkOptions
from pipeline.generation.check_rows import (
    CheckJob,
    Problem,
    differences,
    labyrinths_of,
    made_again,
    rows_of,
)
from pipeline.generation.shard import Fingerprint, Row, no_garbage_collection, render
from pipeline.generation.shifts import Train, selected_shifts, train_of
from pipeline.generation.table import (
    Content,
    Facts,
    facts_table,
    opened_table,
    read_schema,
    table_part,
)
from pipeline.inspection import Companion, routes_of
from pipeline.machinery import ordered_map, say, tracked

PROBLEMS_SHOWN = 20


class ValidationError(DatasetError):
    """A dataset is not valid; `problems` has one line for each reason."""

    def __init__(self, folder: AnyPath, problems: list[str]) -> None:
        self.problems = problems
        shown = problems[:PROBLEMS_SHOWN]
        more = len(problems) - len(shown)
        lines = [f"{folder} is not valid:", *shown, *([f"and {more} more"] if more else [])]
        super().__init__("\n  ".join(lines))


def run(job: Job[WorkOptions]) -> None:
    """Validate the dataset in the folder of a run.

    Raises:
        ValidationError: The dataset is wrong; the message names file, row and field.
        DatasetError: The dataset does not exist.
    """
    data, workers = Dataset.at(job.folder), job.options.workers
    problems = validate(data, workers)
    rows = sum(shard.rows for shard in data.manifest.shards)
    valid = [f"{job.folder} is valid: {rows:,} rows replayed."]
    for kind in Companion.kinds():
        if (made := kind.of(job.data_dir, data.manifest)) is not None:
            problems += kind.problems(data, made, workers)
            rows = sum(shard.rows for shard in made.manifest.shards)
            valid.append(f"{made.folder} is valid: {rows:,} {kind.suffix}.")
    if problems:
        raise ValidationError(job.folder, problems)
    for line in valid:
        say(line)


@dataclass(frozen=True)
class ShardReport:
    """The problems and the structures of one shard."""

    shard: Shard
    problems: list[str]
    structures: NDArray[np.int64] = field(default_factory=lambda: np.empty((0, 2), np.int64))
    """The id of each labyrinth's structure, and the labyrinth's first row: shape (labyrinths, 2).
    There may be millions."""


def validate(data: Dataset, workers: int = 1) -> list[str]:
    """Return what is wrong with a dataset, one line for each problem.

    Args:
        data: The dataset.
        workers: The number of processes.
    """
    manifest = data.manifest
    problems, comparable = table_file_problems(data)
    try:
        train = _train(data)
    except DatasetError as error:
        train, shifts = Train(), ", ".join(selected_shifts(manifest.config))
        problems.append(f"{shifts}: not compared with train, which cannot be read: {error}")
    jobs = list(_jobs(data, comparable, train))
    reports = tracked(
        ordered_map(check_shard, jobs, workers),
        "validate",
        sum(shard.rows for shard in manifest.shards),
        lambda report: report.shard.rows,
    )
    listed = {Manifest.TABLE, *(shard.path for shard in manifest.shards)}
    unlisted = sorted({path.name for path in data.folder.glob("*.parquet")} - listed)
    problems += [f"{name} is not in the manifest" for name in unlisted if not is_litter(name)]
    own: list[ShardReport] = []
    for report in reports:
        problems += report.problems
        if SPLITS[report.shard.split].parent is None:
            own.append(report)
    return [*problems, *_repeated(own), *_miscounted(manifest)]


def check_shard(job: CheckJob) -> ShardReport:
    """Return the problems of one shard, and the rows of its structures."""
    import pyarrow as pa

    path = job.shard.path
    try:
        with File(job.file.path).local_copy() as local:
            if not read_schema(local).equals(COLUMNS.arrow_schema(), check_metadata=False):
                return ShardReport(job.shard, [f"{path}: its columns are not a dataset's"])
            with COLUMNS.opened(local) as file, no_garbage_collection():
                if problem := job.shard.footer_problem(file):
                    return ShardReport(job.shard, [f"{path}: {problem}"])
                return _compared(job, file, local)
    except FileNotFoundError:
        return ShardReport(job.shard, [f"{path} is missing"])
    except MemoryError:  # Also Arrow's; nothing is wrong with the file.
        raise
    except (OSError, pa.ArrowException, UnicodeDecodeError) as error:
        return ShardReport(job.shard, [f"{path} cannot be read: {one_line(error)}"])


def _compared(job: CheckJob, file: Any, local: Path) -> ShardReport:
    """Compare the rows of a file with those that are made again, and with its manifest."""
    shard, content, fingerprint = job.shard, Content(job.config, job.shard.split), Fingerprint()
    problems, unreadable, begins = list[Problem](), list[str](), list[int]()

    def noted(part: list[Row]) -> list[Row]:
        fingerprint.update(part)
        return part

    try:
        for found, right in made_again(job, labyrinths_of(rows_of(file, problems)), problems):
            solution = right.solution
            parts = map(noted, render(shard.split, right.number, right.info, solution.episodes))
            problems += differences(job, found, right, chain.from_iterable(parts))
            content.add(right.info, solution, right.parent)
            begins.append(found.first)
    except DatasetError as error:
        assert job.parent is not None
        why = f"{job.parent.shard.path}, which cannot be read: {one_line(error)}"
        unreadable.append(f"{shard.path} cannot be compared with {why}")
    lines = [f"{shard.path} row {row} {column}: {what}" for row, column, what in problems]
    lines += unreadable
    known: dict[str, int | str] = {"bytes": local.stat().st_size, "sha256": File(local).sha256()}
    if not lines:  # If rows are wrong, their counts and fingerprint are not known.
        known |= content.counts | {"fingerprint": fingerprint.hexdigest()}
    lines += (
        f"{shard.path}: {name} {value}, but the manifest says {expected}"
        for name, value in known.items()
        if value != (expected := getattr(shard, name))
    )
    facts = content.facts()
    if job.table_row is not None and not lines:
        lines += table_problems(job, facts, job.table_row)
    structures = np.column_stack([facts["structure_id"], np.array(begins, np.int64)])
    return ShardReport(shard, lines, structures)


def _miscounted(manifest: Manifest) -> Iterator[str]:
    """Yield a message for each split with too few or too many labyrinths or shards."""
    splits, asked = manifest.config.splits, manifest.config.labyrinths
    shards_of = {
        split: [each for each in manifest.shards if each.split == split] for split in splits
    }
    for split, shards in shards_of.items():
        held, parent = sum(shard.labyrinths for shard in shards), SPLITS[split].parent
        # A shift leaves out labyrinths without such a variant; `check_shard` checks which.
        short = split in SPLITS.shifts and parent is not None and 0 < held < asked
        if held != asked and not short:
            yield f"{split} holds {held} labyrinths, not {asked}"
        if parent and len(shards) != (of_parent := len(shards_of[parent])):
            yield f"{split} has {len(shards)} shards, and {parent}, its parent, {of_parent}"


def _jobs(data: Dataset, with_table: bool, train: Train) -> Iterator[CheckJob]:
    """Yield the job of each shard; a labyrinth with a parent has the parent's number."""
    manifest = data.manifest
    same_bytes = manifest.is_of_current_versions
    splits, table_row = manifest.config.splits, 0
    files_of: dict[str, list[ShardFile]] = {split: [] for split in splits}
    for file in data.files():
        files_of.setdefault(file.shard.split, []).append(file)
    for split in splits:
        parent = SPLITS[split].parent
        numbered = files_of[parent or split]
        first = first_row = 0
        for file, of_parent in zip(files_of[split], numbered, strict=False):
            yield CheckJob(
                file,
                manifest.config,
                first,
                first_row,
                same_bytes,
                train,
                parent=of_parent if parent else None,
                table_row=table_row if with_table else None,
            )
            first += of_parent.shard.labyrinths
            first_row += file.shard.rows
            table_row += file.shard.labyrinths


def _train(data: Dataset) -> Train:
    """Return the properties of train that the shifts of a dataset need.

    Raises:
        DatasetError: Train cannot be read.
    """
    config = data.manifest.config
    if not selected_shifts(config):
        return Train()
    cells = config.height * config.width
    routes = (route for file in data.files("train") for route in routes_of(file))
    of_labyrinths = groupby(routes, lambda route: route.labyrinth)
    return train_of(
        config,
        (
            (labyrinth, ([state % cells for state in route.states] for route in its_routes))
            for labyrinth, its_routes in of_labyrinths
        ),
    )


def _repeated(reports: Sequence[ShardReport]) -> Iterator[str]:
    """Yield a message for each structure that an earlier row has, too."""
    ids, rows = np.concatenate([np.empty((0, 2), np.int64), *(r.structures for r in reports)]).T
    begins = np.cumsum([0, *(len(report.structures) for report in reports)])
    order = np.argsort(ids, kind="stable")
    ordered = ids[order]

    def shard_of(index: int) -> str:
        return reports[int(np.searchsorted(begins, index, "right")) - 1].shard.path

    for index in sorted(order[1:][ordered[1:] == ordered[:-1]].tolist()):
        first = int(order[np.searchsorted(ordered, ids[index])])
        here, there = shard_of(index), shard_of(first)
        also = f"row {rows[first]}" if there == here else f"{there} row {rows[first]}"
        yield f"{here} row {rows[index]} info: the structure is also in {also}"


def table_file_problems(data: Dataset) -> tuple[list[str], bool]:
    """Return what is wrong with the table of labyrinths as a file, and if rows can be compared."""
    import pyarrow as pa

    path, manifest = data.folder / Manifest.TABLE, data.manifest
    try:
        problems = []
        digest, expected = File(path).sha256(), manifest.table.sha256
        if digest != expected:
            problems.append(f"{Manifest.TABLE}: sha256 {digest}, but the manifest says {expected}")
        with opened_table(path) as file:
            rows, schema = file.metadata.num_rows, file.schema_arrow
    except FileNotFoundError:
        return [f"{Manifest.TABLE} is missing"], False
    except (OSError, pa.ArrowException) as error:
        return [f"{Manifest.TABLE} cannot be read: {one_line(error)}"], False
    expected_rows = sum(shard.labyrinths for shard in manifest.shards)
    if not schema.equals(TABLE_COLUMNS.arrow_schema(), check_metadata=False):
        problems.append(f"{Manifest.TABLE}: its columns are not those of a table of labyrinths")
    elif rows != expected_rows:
        problems.append(
            f"{Manifest.TABLE}: {rows} rows, but the manifest has {expected_rows} labyrinths"
        )
    else:
        return problems, True
    return problems, False


def table_problems(job: CheckJob, facts: Facts, first: int) -> Iterator[str]:
    """Yield a message for each column of the table that differs from the rows of a shard.

    Each column is named once, with the first row in which it is wrong.

    Args:
        job: The job of the shard.
        facts: The facts that follow from the rows of the shard.
        first: The row of the table with the first labyrinth of the shard.
    """
    import pyarrow as pa

    try:
        part = table_part(job.file.folder / Manifest.TABLE, first, len(facts))
    except (OSError, ValueError, pa.ArrowException) as error:
        yield f"{Manifest.TABLE} cannot be read: {one_line(error)}"
        return
    expected = facts_table(job.config, job.shard.split, facts, job.first_row)
    for name in expected.column_names:
        pairs = zip(part[name].to_pylist(), expected[name].to_pylist(), strict=True)
        for row, (value, right) in enumerate(pairs, first):
            if value != right:
                row_name = f"{Manifest.TABLE} row {row} {name}"
                yield f"{row_name}: {value!r:.99}, but the shard gives {right!r}"
                break

"""The check of one shard, in which every row is replayed.

The labyrinth is parsed from `info`, states and rewards come from replaying `actions`, pictures from
the renderer; the file must hold the same, byte for byte if the libraries are the manifest's. The
routes must be those that the configuration asks for, and the structures must be in the split that
their hash allows.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

from labyrinth_core.data.columns import (
    Row,
    arrow_schema,
    footer_problem,
    open_shard,
    read_schema,
    tables_of,
    texts,
)
from labyrinth_core.data.dataset_config import DatasetConfig
from labyrinth_core.data.errors import one_line
from labyrinth_core.data.manifest import Shard
from labyrinth_core.data.storage import AnyPath, file_sha256, local_copy
from pipeline.generation.check_rows import ShardCheck
from pipeline.generation.check_table import TablePart, table_problems
from pipeline.generation.extremes import NO_EXTREMES, Extremes


@dataclass
class ShardReport:
    """The problems and the structures of one shard."""

    shard: Shard
    problems: list[str] = field(default_factory=list)
    structures: dict[str, int] = field(default_factory=dict)
    """Structure id -> the first row it is in."""

    def problem(self, row: int, column: str, message: str) -> None:
        """Note a problem with a field of a row."""
        self.problems.append(f"{self.shard.path} row {row} {column}: {message}")


@dataclass(frozen=True)
class CheckJob:
    """All that a worker needs to check one shard."""

    folder: AnyPath
    shard: Shard
    config: DatasetConfig
    first: int
    """The index of its first labyrinth in the split."""
    same_bytes: bool
    """Whether pictures must be equal byte for byte, since the libraries are the manifest's."""
    table: TablePart | None = None
    """Its place in the table of labyrinths, if that is to be compared."""
    parent: Shard | None = None
    """The shard with the labyrinths that those of a shift are made from."""
    extremes: Extremes = NO_EXTREMES
    """Those of train."""


def check_shard(job: CheckJob) -> ShardReport:
    """Return what is wrong with one shard."""
    import pyarrow as pa

    report = ShardReport(job.shard)
    path = job.folder / job.shard.path
    try:
        with local_copy(path) as local:
            found: dict[str, Any] = {"bytes": local.stat().st_size, "sha256": file_sha256(local)}
            if not read_schema(local).equals(arrow_schema(), check_metadata=False):
                report.problems.append(f"{job.shard.path}: its columns are not the five")
                return report
            check = ShardCheck(job, report)
            with open_shard(local) as file:
                problem = footer_problem(file, job.shard.rows)
                if problem is not None:
                    report.problems.append(f"{job.shard.path}: {problem}")
                    return report
                found |= check.check(_rows(file, report))
    except FileNotFoundError:
        report.problems.append(f"{job.shard.path} is missing")
        return report
    except MemoryError:  # Of Arrow, too; nothing is wrong with the file.
        raise
    except (OSError, pa.ArrowException, UnicodeDecodeError) as error:
        report.problems.append(f"{job.shard.path} cannot be read: {one_line(error)}")
        return report
    for name, value in found.items():
        expected = getattr(job.shard, name)
        if value != expected:
            report.problems.append(
                f"{job.shard.path}: {name} {value}, but the manifest says {expected}"
            )
    # What the table should say of a shard with problems is not known.
    if job.table is not None and not report.problems:
        facts = check.facts.array()
        report.problems += table_problems(
            job.folder, job.config, job.shard.split, job.table, facts, check.numbers
        )
    return report


def _rows(file: Any, report: ShardReport) -> Iterator[Row]:
    """Yield the rows of a file, up to the first that has a null."""
    first = 0
    for table in tables_of(file):
        values = ("obs", "actions", "rewards", "episode_starts")
        columns = [*(table[name].to_pylist() for name in values), texts(table["info"])]
        del table  # It holds the pictures a second time.
        rows = zip(*columns, strict=True)
        for number, (obs, action, paid, starts, info) in enumerate(rows, start=first):
            picture = obs or {"bytes": None, "path": None}
            row = Row(picture["bytes"], picture["path"], action, paid, starts, info, b"")
            missing = [name for name, value in row._asdict().items() if value is None]
            if missing:
                report.problem(number, missing[0].removesuffix("_path"), "nothing there")
                return
            yield row
        first += len(columns[0])

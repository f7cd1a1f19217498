"""The check of the table of labyrinths against what the rows of the shards say."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from labyrinth_core.data.dataset_config import DatasetConfig
from labyrinth_core.data.errors import one_line
from labyrinth_core.data.labyrinth_table import TABLE, table_schema
from labyrinth_core.data.manifest import Manifest
from labyrinth_core.data.splits import parent_split
from labyrinth_core.data.storage import AnyPath, file_sha256
from pipeline.generation.tabulate import Facts, table_of

if TYPE_CHECKING:
    import pyarrow as pa
    import pyarrow.parquet as pq


@dataclass(frozen=True)
class TablePart:
    """The place of a shard's labyrinths in the table."""

    first: int
    """The row of the table with the first of them."""
    parents: int | None
    """The row with the first labyrinth of the split that they are made from."""
    first_row: int
    """The number of the split's rows before those of the shard."""


def table_parts(manifest: Manifest) -> list[TablePart]:
    """Return the place of each shard of a manifest."""
    parts = []
    begins: dict[str, int] = {}
    first, first_row = 0, dict.fromkeys((shard.split for shard in manifest.shards), 0)
    for shard in manifest.shards:
        begins.setdefault(shard.split, first)
        of = parent_split(shard.split)
        parents = None if of is None else begins.get(of, 0)
        parts.append(TablePart(first, parents, first_row[shard.split]))
        first += shard.labyrinths
        first_row[shard.split] += shard.rows
    return parts


def table_file_problems(folder: AnyPath, manifest: Manifest) -> tuple[list[str], bool]:
    """Return what is wrong with the file as a whole, and whether its rows can be compared."""
    import pyarrow as pa

    if manifest.labyrinths is None:
        return [], False
    path = folder / TABLE
    try:
        problems = []
        digest, expected = file_sha256(path), manifest.labyrinths.sha256
        if digest != expected:
            problems.append(f"{TABLE}: sha256 {digest}, but the manifest says {expected}")
        with _open(path) as file:
            rows, schema = file.metadata.num_rows, file.schema_arrow
    except FileNotFoundError:
        return [f"{TABLE} is missing"], False
    except (OSError, pa.ArrowException) as error:
        return [f"{TABLE} cannot be read: {one_line(error)}"], False
    wanted = sum(shard.labyrinths for shard in manifest.shards)
    if not schema.equals(table_schema(), check_metadata=False):
        problems.append(f"{TABLE}: its columns are not those of a table of labyrinths")
    elif rows != wanted:
        problems.append(f"{TABLE}: {rows} rows, but the manifest has {wanted} labyrinths")
    else:
        return problems, True
    return problems, False


def table_problems(
    folder: AnyPath,
    config: DatasetConfig,
    split: str,
    part: TablePart,
    facts: Facts,
    numbers: Sequence[int],
) -> Iterator[str]:
    """Yield the columns of a part of the table that are not what the rows of a shard give.

    Each is named once, with the first row in which it is wrong. `numbers` are those of the
    labyrinths in their split, or of those that they are made from in theirs.
    """
    import pyarrow as pa

    known = facts.copy()
    try:
        if part.parents is not None:
            first, count = numbers[0], numbers[-1] - numbers[0] + 1
            ids = _rows(folder, part.parents + first, count)["labyrinth_id"].to_pylist()
            known["parent_id"] = [int(ids[number - first], 16) for number in numbers]
        found = _rows(folder, part.first, len(facts))
    except (OSError, ValueError, TypeError, LookupError, pa.ArrowException) as error:
        yield f"{TABLE} cannot be read: {one_line(error)}"
        return
    expected = table_of(config, split, known, part.first_row)
    for name in expected.column_names:
        if found[name].equals(expected[name]):
            continue
        pairs = zip(found[name].to_pylist(), expected[name].to_pylist(), strict=True)
        differing = ((row, a, b) for row, (a, b) in enumerate(pairs, part.first) if a != b)
        for row, value, right in differing:
            yield f"{TABLE} row {row} {name}: {value!r:.99}, but the shard gives {right!r}"
            break


def _rows(folder: AnyPath, first: int, count: int) -> pa.Table:
    """Return some rows of the table, reading the row groups that they are in."""
    with _open(folder / TABLE) as file:
        sizes = [file.metadata.row_group(n).num_rows for n in range(file.num_row_groups)]
        ends = np.cumsum([0, *sizes])
        begin, end = np.searchsorted(ends, first, "right") - 1, np.searchsorted(ends, first + count)
        table = file.read_row_groups([*range(begin, end)], use_threads=False)
    return table.slice(first - int(ends[begin]), count)


@contextmanager
def _open(path: AnyPath) -> Iterator[pq.ParquetFile]:
    """Open a Parquet file, which may be in an object store, to be read without further threads.

    A thread of Arrow that still holds a buffer of a Python file when the interpreter ends aborts
    the process (https://github.com/apache/arrow/issues/34314).
    """
    import pyarrow.parquet as pq

    with path.open("rb") as opened, pq.ParquetFile(opened, pre_buffer=False) as file:
        yield file

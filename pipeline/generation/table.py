"""The table of labyrinths: the facts of each shard, and the file that joins them.

The facts of a shard are an array in its sidecar until all shards are finished, so that a resumed
build need not solve a labyrinth again.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.data import TABLE_COLUMNS, Dataset, DatasetConfig, Manifest, Shard
from labyrinth_core.language import labyrinth_id
from labyrinth_core.storage import AnyPath
from labyrinth_core.world import Labyrinth, Solver
from pipeline.generation.labyrinths import Solution

if TYPE_CHECKING:
    import pyarrow as pa
    import pyarrow.parquet as pq

FACTS = np.dtype(
    [
        *((name, "<i8") for name in ("labyrinth_id", "structure_id", "parent_id")),
        ("optimal_routes", "<i8"),
        *((name, "<i4") for name in ("start", "goal", "moves", "turns", "episodes", "rows")),
        *((name, "<i4") for name in ("optimal_actions", "loops", "branching", "dead_ends")),
    ]
)
"""The facts of a labyrinth that follow from its shard alone; ids are 63-bit numbers."""

NOTHING = -1
"""The value of `parent_id` or `turns` where the table has null."""

MOST_ROUTES = 2**63 - 1
"""The largest number of routes in the table; it also stands for all larger numbers."""

GROUP_ROWS = 100_000
"""The least number of rows in a row group of the table, except the last; about 10 MB."""

Facts = NDArray[np.void]


class Content:
    """The counts and facts of a shard, collected labyrinth by labyrinth."""

    def __init__(self, config: DatasetConfig, split: str) -> None:
        self._config, self._split = config, split
        self._rows: list[tuple[int, ...]] = []
        self.counts = dict.fromkeys(("labyrinths", "episodes", "rows", "longest", "cut"), 0)
        """The counts of the shard for the manifest: see `Shard`."""

    def add(self, info: str, solution: Solution, parent: Labyrinth | None) -> None:
        """Add a labyrinth.

        Args:
            info: Its text.
            solution: Its episodes.
            parent: The labyrinth that it was made from; None if it has no parent.
        """
        labyrinth, structure = solution.labyrinth, solution.labyrinth.structure
        demonstrated = self._split != "random"
        moves, optimal_routes = solution.shortest
        routes = [episode.actions for episode in solution.episodes]
        own_id = int(labyrinth_id(info), 16)
        parent_id = NOTHING if parent is None else own_id
        if parent is not None and parent != labyrinth:
            parent_id = int(labyrinth_id(parent), 16)
        turns = sum(one != other for one, other in pairwise(bytes(routes[0])))
        steps = sum(map(len, routes))
        # A noisy demonstrator may end on ice after as many moves.
        is_shortest = demonstrated and not self._config.noise and steps == moves * len(routes)
        counts = self.counts
        counts["labyrinths"] += 1
        counts["episodes"] += len(routes)
        counts["rows"] += steps + len(routes)  # A row for each state.
        counts["longest"] = max(counts["longest"], *map(len, routes))
        several = self._config.solutions != "shortest" and demonstrated
        counts["cut"] += several and len(routes) == self._config.solutions_limit
        self._rows.append(
            (
                own_id,
                int(structure.structure_id, 16),
                parent_id,
                min(optimal_routes, MOST_ROUTES),
                labyrinth.start,
                labyrinth.goal,
                moves,
                turns if demonstrated else NOTHING,
                len(routes),
                steps + len(routes),
                steps if is_shortest else Solver(labyrinth).count_optimal(routes),
                *(structure.loops, structure.junctions, structure.dead_ends),
            )
        )

    def facts(self) -> Facts:
        """Return the facts, one item for each labyrinth."""
        return np.array(self._rows, FACTS)


def structures_in(data: Dataset) -> NDArray[np.int64]:
    """Return the id of each structure in the table of a finished dataset, as a number.

    Raises:
        DatasetError: The table is missing or damaged.
    """
    groups = data.table_groups(["structure_id"])
    return np.concatenate([_numbers(group["structure_id"].to_pylist()) for group in groups])


def table_facts(folder: AnyPath, first: int, count: int) -> Facts:
    """Return facts from the table of a finished dataset; the inverse of `facts_table`.

    Args:
        folder: The folder of the dataset.
        first: The row of the table with the first labyrinth.
        count: The number of labyrinths.
    """
    table = table_part(folder / Manifest.TABLE, first, count)
    facts = np.empty(count, FACTS)
    for name in FACTS.names or ():
        values = table[name].to_pylist()
        if name.endswith("_id"):
            facts[name] = _numbers(values)
        else:
            facts[name] = [NOTHING if value is None else value for value in values]
    return facts


def _numbers(ids: Iterable[str | None]) -> NDArray[np.int64]:
    """Return ids in hexadecimal digits as numbers; None becomes `NOTHING`."""
    digits = "".join(text or "f" * 16 for text in ids)
    return np.frombuffer(bytes.fromhex(digits), ">i8").astype(np.int64)


def table_part(path: AnyPath, first: int, count: int) -> pa.Table:
    """Return `count` rows of the table from row `first`; only their row groups are read."""
    with opened_table(path) as file:
        sizes = [file.metadata.row_group(n).num_rows for n in range(file.num_row_groups)]
        ends = np.cumsum([0, *sizes])
        begin, end = np.searchsorted(ends, first, "right") - 1, np.searchsorted(ends, first + count)
        table = file.read_row_groups([*range(begin, end)], use_threads=False)
    return table.slice(first - int(ends[begin]), count)


@contextmanager
def opened_table(path: AnyPath) -> Iterator[pq.ParquetFile]:
    """Open a Parquet file, which may be in an object store, for reading without further threads.

    A thread of Arrow that still holds a buffer of a Python file when the interpreter ends aborts
    the process (https://github.com/apache/arrow/issues/34314).
    """
    import pyarrow.parquet as pq

    with path.open("rb") as opened, pq.ParquetFile(opened, pre_buffer=False) as file:
        yield file


def facts_table(config: DatasetConfig, split: str, facts: Facts, first_row: int) -> pa.Table:
    """Return facts as rows of the table; the first labyrinth begins at `first_row` of its split."""
    import pyarrow as pa

    count, schema = len(facts), TABLE_COLUMNS.arrow_schema()
    rows = facts["rows"].astype(np.int64)
    given: dict[str, Any] = {
        "split": split,
        "task": str(config.task),
        "height": np.full(count, config.height),
        "width": np.full(count, config.width),
        "first_row": first_row + np.cumsum(rows) - rows,
    }

    def column(name: str, kind: pa.DataType) -> pa.Array:
        values = given[name] if name in given else facts[name]
        if isinstance(values, str):
            ends = np.arange(count + 1, dtype=np.int32) * len(values)
            return value_array(kind, count, ends, values.encode() * count)
        if name in ("parent_id", "turns") and (values == NOTHING).all():
            return pa.nulls(count, kind)
        if pa.types.is_string(kind):  # All digits at once, sixteen of each id.
            ends = np.arange(count + 1, dtype=np.int32) * 16
            digits = values.astype(">i8").tobytes().hex().encode()
            return value_array(kind, count, ends, digits)
        return value_array(kind, count, values.astype(kind.to_pandas_dtype()))

    columns = [column(each.name, schema.field(each.name).type) for each in TABLE_COLUMNS]
    return pa.Table.from_arrays(columns, schema=schema)


def write_table(path: Path, config: DatasetConfig, parts: Iterable[tuple[Shard, Facts]]) -> None:
    """Write the table part by part.

    Args:
        path: The file.
        config: The configuration of the dataset.
        parts: The shards in the order of splits and rows, each with its facts.

    Raises:
        OSError: The file cannot be written, say because the disk is full.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    schema = TABLE_COLUMNS.arrow_schema()
    words = ["split", "task", *(field.name for field in schema if field.type == pa.int32())]
    with pq.ParquetWriter(
        path, schema, compression="zstd", use_dictionary=words, store_schema=False
    ) as writer:
        writer.add_key_value_metadata(schema.metadata)
        for group in _groups(config, parts):
            writer.write_table(group)


def _groups(config: DatasetConfig, parts: Iterable[tuple[Shard, Facts]]) -> Iterator[pa.Table]:
    """Yield the rows of the table; small shards are joined into one group."""
    import pyarrow as pa

    group: list[pa.Table] = []
    first_row: dict[str, int] = {}
    for shard, facts in parts:
        row = first_row.setdefault(shard.split, 0)
        group.append(facts_table(config, shard.split, facts, row))
        first_row[shard.split] = row + shard.rows
        if sum(part.num_rows for part in group) >= GROUP_ROWS:
            yield pa.concat_tables(group)
            group = []
    if group:
        yield pa.concat_tables(group)


def read_schema(path: Path) -> pa.Schema:
    """Return the Arrow schema of a Parquet file; raise OSError or ArrowException if it has none.

    `pyarrow.parquet.read_schema` makes a reference cycle through `FileMetaData.schema`, which keeps
    megabytes a shard until the garbage collector runs.
    """
    import pyarrow.parquet as pq

    with pq.ParquetFile(path) as file:
        return file.schema_arrow


# `pa.array` would import pandas (60 MB). A build of 100 labyrinths at 5x5 would take 25% longer, a
# build of 400 labyrinths 18% (run.py, CPU time of the process).


def text_array(type_: pa.DataType, values: Sequence[bytes]) -> pa.Array:
    """Return texts or bytes as an array."""
    ends = np.cumsum([0, *map(len, values)], dtype=np.int32)
    return value_array(type_, len(values), ends, b"".join(values))


def value_array(type_: pa.DataType, count: int, *content: NDArray[Any] | bytes) -> pa.Array:
    """Return an array of `count` values without nulls, from the buffers that Arrow would have."""
    import pyarrow as pa

    return pa.Array.from_buffers(type_, count, [None, *map(pa.py_buffer, content)])

"""The five columns of a dataset, for writer, reader and documents alike."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from labyrinth_core.world.grid import Action

if TYPE_CHECKING:
    import pyarrow
    import pyarrow.parquet

NO_ACTION = -1
"""The value of `actions` in the last row of an episode, in which no action is taken."""


GROUP_BYTES = 64 << 20
"""The bytes of pictures after which a row group ends, within an episode if need be.

The Hub's viewer reads no group of more than 286 MiB, and needs several times its size in memory. A
group of 256 rows has 7 MB at 100x100, 41 MB at 250x250.
"""

BATCH_ROWS = 4096
"""The rows that are read at once; a hostile file may repeat a large picture in many rows."""

MOST_ROWS, MOST_BYTES = GROUP_BYTES // 512, 4 * GROUP_BYTES
"""The rows and the bytes that no row group exceeds; no picture has fewer than 512 bytes."""


class Column(NamedTuple):
    """One column of a file of ours."""

    name: str
    feature: dict[str, Any]
    """The feature, as the library `datasets` describes it in Parquet files and cards."""
    meaning: str

    @classmethod
    def of(cls, name: str, dtype: str, meaning: str) -> Column:
        """Return a column of plain values, such as `int32` or `string`."""
        return cls(name, {"dtype": dtype, "_type": "Value"}, meaning)


COLUMNS = (
    Column("obs", {"_type": "Image"}, "picture of the state, 600 x 600 RGB, PNG"),
    Column(
        "actions",
        {"names": [action.name.lower() for action in Action], "_type": "ClassLabel"},
        "action taken: 0 up, 1 right, 2 down, 3 left; -1 in the last row of an episode",
    ),
    Column.of(
        "rewards",
        "float32",
        "reward received for the action; 0 in the last row of an episode",
    ),
    Column.of("episode_starts", "bool", "whether the row is the first of an episode"),
    Column.of("info", "string", "the labyrinth, in the text language that loads it again"),
)


class Row(NamedTuple):
    """One state of an episode, in the dataset's columns."""

    obs: bytes
    """The picture as a PNG file."""
    obs_path: str
    """The name of the picture, unique in its config."""
    actions: int
    rewards: float
    episode_starts: bool
    info: str
    picture_digest: bytes
    """The digest of its pixels, which is not a column."""


def arrow_schema(columns: Sequence[Column] = COLUMNS) -> pyarrow.Schema:
    """Return the Arrow schema of files, with the metadata in which `datasets` keeps features.

    It is written out, since importing `datasets` takes longer than building a small dataset.
    """
    import pyarrow as pa

    types = {
        "Image": pa.struct({"bytes": pa.binary(), "path": pa.string()}),
        "ClassLabel": pa.int64(),
        "List": pa.list_(pa.string()),
        "string": pa.string(),
        "bool": pa.bool_(),
        "float32": pa.float32(),
        "int32": pa.int32(),
        "int64": pa.int64(),
    }
    features = {"info": {"features": {column.name: column.feature for column in columns}}}
    return pa.schema(
        [(each.name, types[each.feature.get("dtype", each.feature["_type"])]) for each in columns],
        metadata={"huggingface": json.dumps(features)},
    )


def open_shard(path: Path) -> pyarrow.parquet.ParquetFile:
    """Open a Parquet file; a column `info` is read dictionary-encoded, see `texts`.

    Raises:
        OSError, ArrowException: The file cannot be read.
    """
    import pyarrow.parquet as pq

    names = read_schema(path).names
    return pq.ParquetFile(path, read_dictionary=["info"] if "info" in names else [])


def footer_problem(file: pyarrow.parquet.ParquetFile, rows: int) -> str | None:
    """Return what in the footer of a file shows that it is not ours, before any row is read.

    A few bytes of a file may stand for any number of rows, and a row group is read as a whole.

    Args:
        file: The file.
        rows: The number of rows that the manifest says it has.
    """
    footer = file.metadata
    if footer.num_rows != rows:
        return f"rows {footer.num_rows}, but the manifest says {rows}"
    for group in map(footer.row_group, range(footer.num_row_groups)):
        if group.num_rows > MOST_ROWS:
            return f"a row group of {group.num_rows} rows, but none has more than {MOST_ROWS}"
        if group.total_byte_size > MOST_BYTES:
            return f"a row group of {group.total_byte_size} bytes, more than {MOST_BYTES}"
    return None


def tables_of(
    file: pyarrow.parquet.ParquetFile, columns: list[str] | None = None, *, together: int = 1
) -> Iterator[pyarrow.Table]:
    """Yield the rows of a file, those of a row group at once unless they are very many.

    Args:
        file: The file.
        columns: The names of the columns to read; None for all.
        together: How many row groups are opened at once, which is quicker where rows are small.
    """
    import pyarrow as pa

    groups = range(file.num_row_groups)
    for first in groups[::together]:
        # `map` lets go of each batch, of which there would otherwise be two.
        batches = file.iter_batches(BATCH_ROWS, groups[first : first + together], columns)
        yield from map(pa.Table.from_batches, map(list, zip(batches, strict=True)))


def read_schema(path: Path) -> pyarrow.Schema:
    """Return the Arrow schema of a Parquet file; raise as `open_shard` does.

    `pyarrow.parquet.read_schema` makes a reference cycle through `FileMetaData.schema`, which keeps
    megabytes a shard until the garbage collector runs.
    """
    import pyarrow.parquet as pq

    with pq.ParquetFile(path) as file:
        return file.schema_arrow


def texts(column: pyarrow.ChunkedArray) -> list[str | None]:
    """Return the texts of a column, equal ones as one object if it is dictionary-encoded.

    The text of a labyrinth of 250x250 has half a megabyte, and hundreds of rows share it.
    """
    import pyarrow as pa

    if not pa.types.is_dictionary(column.type):
        return column.to_pylist()  # type: ignore[no-any-return]
    found: list[str | None] = []
    for chunk in column.chunks:
        values = [*chunk.dictionary.to_pylist(), None]
        found += [values[-1 if place is None else place] for place in chunk.indices.to_pylist()]
    return found

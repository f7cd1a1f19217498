"""Rows to a Parquet file that the Hub's tools read: one shard."""

from __future__ import annotations

import gc
import json
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.data.format import COLUMNS, GROUP_BYTES, NO_ACTION, Column
from labyrinth_core.data.manifest import Shard
from labyrinth_core.data.storage import file_sha256
from pipeline.generation.fingerprint import Fingerprint, Row

if TYPE_CHECKING:
    import pyarrow as pa

ROW_GROUP = 256
"""The number of rows after which a row group ends, at the next end of an episode."""

WRITER_OPTIONS = {
    # docs/performance.md compares them with others.
    "compression": "zstd",
    "compression_level": 1,
    "use_dictionary": ["info"],
    # Statistics of pictures would be pictures.
    "write_statistics": ["actions", "rewards", "episode_starts"],
    "write_page_index": True,
    # It would say that texts are places in a dictionary, also to readers.
    "store_schema": False,
}


def arrow_schema(columns: Sequence[Column] = COLUMNS) -> pa.Schema:
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


def write(
    path: Path, split: str, episodes: Iterable[list[Row]], *, group_bytes: int = GROUP_BYTES
) -> Shard:
    """Write episodes to a Parquet file and return what was written, without `labyrinths` and `cut`.

    Args:
        path: The file.
        split: The split that it is a shard of.
        episodes: The rows of each episode, those of a long one in parts.
        group_bytes: The bytes of pictures after which a row group ends within an episode.

    Raises:
        OSError: The file cannot be written, say because the disk is full.
    """
    import pyarrow.parquet as pq

    fingerprint = Fingerprint()
    rows = count = length = longest = 0
    with (
        no_garbage_collection(),
        pq.ParquetWriter(path, written_schema(), **WRITER_OPTIONS) as writer,
    ):
        writer.add_key_value_metadata(arrow_schema().metadata)
        group: list[Row] = []
        for part in episodes:
            fingerprint.update(part)
            group += part
            rows += len(part)
            length += len(part)
            last = part[-1]
            ended = last.actions == NO_ACTION
            if ended:
                count += 1
                longest = max(longest, length - 1)
                length = 0
            if (ended and len(group) >= ROW_GROUP) or len(group) * len(last.obs) >= group_bytes:
                writer.write_table(rows_table(group))
                group = []
        if group:
            writer.write_table(rows_table(group))
    return Shard(
        path=path.name,
        split=split,
        labyrinths=0,
        episodes=count,
        rows=rows,
        longest=longest,
        cut=0,
        bytes=path.stat().st_size,
        sha256=file_sha256(path),
        fingerprint=fingerprint.hexdigest(),
    )


@contextmanager
def no_garbage_collection() -> Iterator[None]:
    """Switch the garbage collector off; rows hold no reference cycles.

    Collecting garbage costs 5% of a build (1,500 labyrinths at 5x5, CPU time): each collection
    visits all objects of the imported libraries.
    """
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()


def rows_table(rows: list[Row]) -> pa.Table:
    """Return rows as a table with each text of `info` once: it is long, and many rows share it."""
    import pyarrow as pa

    schema = written_schema()
    pngs, names, actions, rewards, starts, infos, _ = zip(*rows, strict=True)
    pictures = pa.StructArray.from_arrays(
        [text_array(pa.binary(), pngs), text_array(pa.string(), [name.encode() for name in names])],
        fields=list(schema.field("obs").type),
    )
    numbers = [
        value_array(pa.int64(), len(rows), np.array(actions, np.int64)),
        value_array(pa.float32(), len(rows), np.array(rewards, np.float32)),
        value_array(pa.bool_(), len(rows), np.packbits(starts, bitorder="little")),
    ]
    places = {info: place for place, info in enumerate(dict.fromkeys(infos))}
    texts = pa.DictionaryArray.from_arrays(
        value_array(pa.int32(), len(rows), np.array([places[info] for info in infos], np.int32)),
        text_array(pa.string(), [info.encode() for info in places]),
    )
    return pa.Table.from_arrays([pictures, *numbers, texts], schema=schema)


# `pa.array` would import pandas, 60 MB. A build of 100 labyrinths at 5x5 would take 25% longer, one
# of 400 labyrinths 18% (run.py, CPU time of the process).


def text_array(type_: pa.DataType, values: Sequence[bytes]) -> pa.Array:
    """Return texts or bytes as an array."""
    ends = np.cumsum([0, *map(len, values)], dtype=np.int32)
    return value_array(type_, len(values), ends, b"".join(values))


def value_array(type_: pa.DataType, count: int, *content: NDArray[Any] | bytes) -> pa.Array:
    """Return an array of `count` values without nulls, from the buffers that Arrow would have."""
    import pyarrow as pa

    return pa.Array.from_buffers(type_, count, [None, *map(pa.py_buffer, content)])


def written_schema() -> pa.Schema:
    """Return the schema of the tables to write; the texts of `info` are in a dictionary."""
    import pyarrow as pa

    schema = arrow_schema()
    texts = pa.field("info", pa.dictionary(pa.int32(), pa.string()))
    return schema.set(schema.get_field_index("info"), texts)


def read_schema(path: Path) -> pa.Schema:
    """Return the Arrow schema of a Parquet file; raise OSError or ArrowException if it has none.

    `pyarrow.parquet.read_schema` makes a reference cycle through `FileMetaData.schema`, which keeps
    megabytes a shard until the garbage collector runs.
    """
    import pyarrow.parquet as pq

    with pq.ParquetFile(path) as file:
        return file.schema_arrow

"""Rows to a Parquet file that the Hub's tools read: one shard."""

from __future__ import annotations

import gc
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

from pipeline.fingerprint import Fingerprint
from pipeline.manifest import file_sha256
from pipeline.schema import Row, arrow_schema

if TYPE_CHECKING:
    import pyarrow as pa

ROW_GROUP = 256
"""Rows after which a group ends, at the next end of an episode."""

WRITER_OPTIONS = {
    # Chosen by scripts/benchmark_parquet.py; see docs/performance.md.
    "compression": "zstd",
    "compression_level": 1,
    "use_dictionary": ["info"],
    # Statistics of pictures would be pictures.
    "write_statistics": ["actions", "rewards", "episode_starts"],
    "write_page_index": True,
    # It would say that texts are places in a dictionary, also to readers.
    "store_schema": False,
}


@dataclass(frozen=True)
class Written:
    """What went into a file."""

    rows: int
    episodes: int
    longest: int
    """Moves in the longest episode."""
    bytes: int
    sha256: str
    fingerprint: str


def write(path: Path, episodes: Iterable[list[Row]]) -> Written:
    """Write episodes to a Parquet file, whole or not at all, and return what was written.

    Args:
        path: Where to; the folder exists.
        episodes: The rows of each; never divided between row groups.

    Raises:
        OSError: The file cannot be written, say because the disk is full; nothing is left.
    """
    import pyarrow.parquet as pq

    temporary = path.with_name(f".{path.name}.tmp")
    fingerprint = Fingerprint()
    rows = count = longest = 0
    try:
        with (
            _uncollected(),
            pq.ParquetWriter(temporary, written_schema(), **WRITER_OPTIONS) as writer,
        ):
            writer.add_key_value_metadata(arrow_schema().metadata)
            group: list[Row] = []
            for episode in episodes:
                fingerprint.update(episode)
                group += episode
                count += 1
                rows += len(episode)
                longest = max(longest, len(episode) - 1)
                if len(group) >= ROW_GROUP:
                    writer.write_table(table_of(group))
                    group = []
            if group:
                writer.write_table(table_of(group))
        written = Written(
            rows=rows,
            episodes=count,
            longest=longest,
            bytes=temporary.stat().st_size,
            sha256=file_sha256(temporary),
            fingerprint=fingerprint.hexdigest(),
        )
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)
    return written


@contextmanager
def _uncollected() -> Iterator[None]:
    """Keep the collector of cycles away; rows have none, and it would walk all that is loaded."""
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()


def table_of(rows: list[Row]) -> pa.Table:
    """Return rows as a table, each text once: an episode's rows have the same, and it is long."""
    import pyarrow as pa

    schema = written_schema()
    pngs, names, *values, infos, _ = zip(*rows, strict=True)
    pictures = pa.StructArray.from_arrays(
        [pa.array(pngs, pa.binary()), pa.array(names, pa.string())],
        fields=list(schema.field("obs").type),
    )
    columns = [
        pa.array(of_rows, type_) for of_rows, type_ in zip(values, schema.types[1:4], strict=True)
    ]
    places = {info: place for place, info in enumerate(dict.fromkeys(infos))}
    texts = pa.DictionaryArray.from_arrays(
        pa.array([places[info] for info in infos], pa.int32()), pa.array(places, pa.string())
    )
    return pa.Table.from_arrays([pictures, *columns, texts], schema=schema)


@lru_cache(maxsize=1)
def written_schema() -> pa.Schema:
    """Return the schema of the files as it is handed to Arrow: texts as places in a dictionary."""
    import pyarrow as pa

    schema = arrow_schema()
    texts = pa.field("info", pa.dictionary(pa.int32(), pa.string()))
    return schema.set(schema.get_field_index("info"), texts)

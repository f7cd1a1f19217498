"""Rows to a Parquet file that the Hub's tools read: one shard."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from pipeline.manifest import Fingerprint, file_sha256
from pipeline.schema import Row, arrow_schema

if TYPE_CHECKING:
    import pyarrow as pa

ROW_GROUP = 256
"""Rows after which a group ends, at the next end of an episode."""

WRITER_OPTIONS = {
    "compression": "zstd",
    "compression_level": 3,
    "use_dictionary": ["info"],
    # Statistics of pictures would be pictures.
    "write_statistics": ["actions", "rewards", "episode_starts"],
    "write_page_index": True,
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
        with pq.ParquetWriter(temporary, arrow_schema(), **WRITER_OPTIONS) as writer:
            group: list[Row] = []
            for episode in episodes:
                for row in episode:
                    fingerprint.update(row)
                group += episode
                count += 1
                rows += len(episode)
                longest = max(longest, len(episode) - 1)
                if len(group) >= ROW_GROUP:
                    writer.write_table(_table(group))
                    group = []
            if group:
                writer.write_table(_table(group))
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


def _table(rows: list[Row]) -> pa.Table:
    import pyarrow as pa

    schema = arrow_schema()
    pictures = pa.StructArray.from_arrays(
        [
            pa.array([row.obs for row in rows], pa.binary()),
            pa.array([row.obs_path for row in rows], pa.string()),
        ],
        fields=list(schema.field("obs").type),
    )
    others = [
        pa.array([getattr(row, field.name) for row in rows], field.type)
        for field in schema
        if field.name != "obs"
    ]
    return pa.Table.from_arrays([pictures, *others], schema=schema)

"""The rows of the datasets of these tests, and leaks planted in them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from labyrinth_core.data import COLUMNS
from labyrinth_core.language import dump, parse
from labyrinth_core.storage import File
from labyrinth_core.world import Labyrinth
from support.tampering import manifest_of

DEFAULT, OTHER = "3x3", "3x4-key_and_door"
"""The two configs in the folder of these tests."""


def shard(folder: Path, split: str) -> Path:
    (path,) = folder.glob(f"{split}-0*.parquet")
    return path


def rows(folder: Path, split: str) -> list[dict[str, Any]]:
    return pq.read_table(shard(folder, split)).to_pylist()


def labyrinths(folder: Path, split: str) -> list[str]:
    """Return the texts of the labyrinths of a split, in order."""
    return list(dict.fromkeys(row["info"] for row in rows(folder, split)))


def plant(folder: Path, split: str, old: str, new: str) -> None:
    """Replace a labyrinth of a split by another one, its actions left as they are."""
    changed = [
        row | {"info": new if row["info"] == old else row["info"]} for row in rows(folder, split)
    ]
    write(folder, split, pa.Table.from_pylist(changed, schema=COLUMNS.arrow_schema()))


def write(folder: Path, split: str, table: pa.Table) -> None:
    """Write a shard, and a manifest that agrees but for the fingerprint."""
    path = shard(folder, split)
    pq.write_table(table, path)
    with manifest_of(folder) as content:
        entry = next(entry for entry in content["shards"] if entry["path"] == path.name)
        size = path.stat().st_size
        entry.update(sha256=File(path).sha256(), bytes=size, rows=len(table))


def transposed(text: str) -> str:
    """Return the mirror image of a labyrinth that keeps start and goal."""
    labyrinth = parse(text)
    return dump(Labyrinth(labyrinth.structure.transposed(), labyrinth.start, labyrinth.goal))

"""The five columns and the six splits of a dataset, for writer, reader and documents alike."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from labyrinth_core.world.grid import Action

if TYPE_CHECKING:
    import pyarrow
    import pyarrow.parquet

SAMPLED_SPLITS = ("train", "validation", "test")
"""The splits with structures of their own."""

SPLITS = {
    "train": "demonstrations to learn from",
    "validation": "other structures, to choose a model with",
    "test": "other structures again, to judge it on",
    "random": "a uniformly random policy on the structures of train",
    "s0": "the structures of train with another start",
    "s0_and_g": "the structures of train with another start and another goal",
}
"""Split -> its content."""


def parent_split(split: str) -> str | None:
    """Return the split of the labyrinths that those of a split are derived from, None if of none.

    They are in the same order: the first is derived from the first, and so on.
    """
    return None if split in SAMPLED_SPLITS else "train"


def is_of_train(split: str) -> bool:
    """Return whether a split holds the labyrinths of train, or those derived from them."""
    return "train" in (split, parent_split(split))


NO_ACTION = -1
"""The value of `actions` in the last row of an episode, in which no action is taken."""


class Column(NamedTuple):
    """One column of the dataset."""

    name: str
    feature: dict[str, Any]
    """The feature, as the library `datasets` describes it in Parquet files and cards."""
    meaning: str


COLUMNS = (
    Column("obs", {"_type": "Image"}, "picture of the state, 600 x 600 RGB, PNG"),
    Column(
        "actions",
        {"names": [action.name.lower() for action in Action], "_type": "ClassLabel"},
        "action taken: 0 up, 1 right, 2 down, 3 left; -1 in the last row of an episode",
    ),
    Column(
        "rewards",
        {"dtype": "float32", "_type": "Value"},
        "reward received for the action; 0 in the last row of an episode",
    ),
    Column(
        "episode_starts",
        {"dtype": "bool", "_type": "Value"},
        "whether the row is the first of an episode",
    ),
    Column(
        "info",
        {"dtype": "string", "_type": "Value"},
        "the labyrinth, in the text language that loads it again",
    ),
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
    """The digest of `fingerprint.picture_digest`, which is not a column."""


def arrow_schema() -> pyarrow.Schema:
    """Return the Arrow schema of the files, with the metadata in which `datasets` keeps features.

    It is written out, since importing `datasets` takes longer than building a small dataset.
    """
    import pyarrow as pa

    types = {
        "obs": pa.struct({"bytes": pa.binary(), "path": pa.string()}),
        "actions": pa.int64(),
        "rewards": pa.float32(),
        "episode_starts": pa.bool_(),
        "info": pa.string(),
    }
    features = {"info": {"features": {column.name: column.feature for column in COLUMNS}}}
    return pa.schema(
        [(column.name, types[column.name]) for column in COLUMNS],
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

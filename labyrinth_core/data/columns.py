"""The five columns of a dataset, for writer, reader and documents alike."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

from labyrinth_core.world.grid import Action

if TYPE_CHECKING:
    import pyarrow

NO_ACTION = -1
"""The value of `actions` in the last row of an episode, in which no action is taken."""


GROUP_BYTES = 64 << 20
"""The bytes of pictures after which a row group ends, within an episode if need be.

The Hub's viewer reads no group of more than 286 MiB, and needs several times its size in memory. A
group of 256 rows has 7 MB at 100x100, 41 MB at 250x250.
"""


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

"""The five columns of a dataset, for writer, reader and documents alike."""

from __future__ import annotations

from typing import Any, NamedTuple

from labyrinth_core.world.dynamics import Action

NO_ACTION = -1
"""The value of `actions` in the last row of an episode, in which no action is taken."""


GROUP_BYTES = 64 << 20
"""The bytes of pictures after which a row group ends, within an episode if need be.

Bytes are estimated from the last picture; a group of less than a quarter ends with an episode. A
shard ends with a labyrinth. Streams rely on both.

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

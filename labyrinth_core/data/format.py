"""The columns of datasets and of the table of labyrinths, for writers, readers and documents."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
from itertools import repeat
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, NamedTuple

import numpy as np

from labyrinth_core.world import Action

if TYPE_CHECKING:
    import pyarrow as pa
    from pyarrow.parquet import ParquetFile

    from labyrinth_core.world import Episode

NO_ACTION = -1
"""The value of `actions` in the last row of an episode, in which no action is taken."""


GROUP_BYTES = 64 << 20
"""The bytes of pictures after which a row group ends, if necessary within an episode.

Bytes are estimated from the last picture. A group of less than a quarter of this ends with an
episode, and a shard ends with a labyrinth; streams rely on both.

The Hub's viewer reads no group of more than 286 MiB, and needs several times its size in memory. A
group of 256 rows has 7 MB at 100x100, 41 MB at 250x250.
"""


class Column(NamedTuple):
    """One column of a dataset's file."""

    name: str
    feature: dict[str, Any]
    """The feature, as the library `datasets` describes it in Parquet files and cards."""
    meaning: str
    values: Callable[[Episode], list[Any]] | None = None
    """Returns the values in the T + 1 rows of an episode, for a column of numbers or booleans of
    the rows: what is written, hashed and checked."""

    @classmethod
    def of(
        cls,
        name: str,
        dtype: str,
        meaning: str,
        values: Callable[[Episode], list[Any]] | None = None,
    ) -> Column:
        """Return a column of plain values, such as `int32` or `string`."""
        return cls(name, {"dtype": dtype, "_type": "Value"}, meaning, values)

    @property
    def type(self) -> str:
        """The name of the type of its values, such as `int32`."""
        kind: str = self.feature.get("dtype", self.feature["_type"])
        return kind

    @property
    def struct(self) -> str:
        """The format of a value of a column of numbers in the module `struct`."""
        formats = {"ClassLabel": "q", "int64": "q", "int32": "i", "float32": "f", "bool": "?"}
        return formats[self.type]

    @property
    def dtype(self) -> np.dtype[Any]:
        """The NumPy type of a column of numbers."""
        return np.dtype(f"<{self.struct}")


class Columns(tuple[Column, ...]):
    """The columns of a file, in order."""

    __slots__ = ()

    @property
    def numbers(self) -> Columns:
        """The columns of numbers and booleans, whose `values` are written, hashed and checked."""
        return Columns(column for column in self if column.values)

    def arrow_schema(self) -> pa.Schema:
        """Return their Arrow schema, with the metadata that tells `datasets` their features.

        The code writes it out, since importing `datasets` takes longer than a small build.
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
        features = {"info": {"features": {column.name: column.feature for column in self}}}
        return pa.schema(
            [(each.name, types[each.type]) for each in self],
            metadata={"huggingface": json.dumps(features)},
        )


COLUMNS = Columns(
    (
        Column("obs", {"_type": "Image"}, "picture of the state, 600 x 600 RGB, PNG"),
        Column(
            "actions",
            {"names": [action.name.lower() for action in Action], "_type": "ClassLabel"},
            "action taken: 0 up, 1 right, 2 down, 3 left; -1 in the last row of an episode",
            lambda episode: [*episode.actions.tolist(), NO_ACTION],
        ),
        Column.of(
            "rewards",
            "float32",
            "reward received for the action; 0 in the last row of an episode",
            lambda episode: [*episode.rewards.tolist(), 0.0],
        ),
        Column.of(
            "episode_starts",
            "bool",
            "whether the row is the first of an episode",
            lambda episode: [True, *repeat(False, len(episode))],
        ),
        Column.of("info", "string", "the labyrinth, in the text language that loads it again"),
    )
)
"""The columns of the rows."""

_NAMED = ("actions", "rewards", "episode_starts")
OTHERS = tuple(column for column in COLUMNS.numbers if column.name not in _NAMED)
"""Those without a field of their own in `LoadedEpisode` and `Transitions`."""

TABLE_COLUMNS = Columns(
    (
        # Text, since numbers of JSON and JavaScript cannot hold sixteen hexadecimal digits.
        Column.of("labyrinth_id", "string", "hash of the labyrinth, sixteen hexadecimal digits"),
        Column.of("structure_id", "string", "hash of its structure, likewise"),
        Column.of("split", "string", "split that it is in"),
        Column.of("parent_id", "string", "labyrinth that it was derived from; null if from none"),
        Column.of("height", "int32", "rows of cells"),
        Column.of("width", "int32", "columns of cells"),
        Column.of("task", "string", "task, such as navigation"),
        Column.of("start", "int32", "cell of the start: row * width + column, row 0 at the bottom"),
        Column.of("goal", "int32", "cell of the goal, likewise"),
        Column.of("moves", "int32", "moves on a shortest route"),
        Column.of(
            "optimal_routes", "int64", "shortest routes; 2**63 - 1 stands for that many or more"
        ),
        Column.of("turns", "int32", "changes of direction on its first route; null in random"),
        Column.of("loops", "int32", "passages beyond those of a tree"),
        Column.of("branching", "int32", "cells with three or four passages"),
        Column.of("dead_ends", "int32", "cells with one passage"),
        Column.of("episodes", "int32", "episodes in the split"),
        Column.of("first_row", "int64", "its first row in the split, counted from 0"),
        Column.of("rows", "int32", "rows in the split, which follow one another"),
        Column.of(
            "optimal_actions", "int32", "actions in its episodes that begin a shortest route"
        ),
    )
)
"""The columns of the table of labyrinths, one row per labyrinth; see `Manifest.TABLE`."""


def open_encoded(source: Path | BinaryIO, columns: Iterable[str], **options: Any) -> ParquetFile:
    """Open a Parquet file and read some columns, if it has them, dictionary-encoded.

    A few bytes of a file may repeat a value of megabytes in thousands of rows. Encoded, each value
    is in memory once.

    Raises:
        OSError, ArrowException: The file cannot be read.
    """
    import pyarrow.parquet as pq

    with pq.ParquetFile(source) as file:
        footer = file.metadata
    there = set()
    if footer.num_row_groups:  # Not from `footer.schema`, which makes a cycle of references.
        group = footer.row_group(0)
        there = {group.column(number).path_in_schema for number in range(group.num_columns)}
    encoded = [name for name in columns if name in there]
    try:
        return pq.ParquetFile(source, metadata=footer, read_dictionary=encoded, **options)
    except KeyError as error:
        raise OSError(f"its footer names a column that it has not: {error}") from error

"""The columns of datasets and of the table of labyrinths, for writers, readers and documents."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from itertools import repeat, starmap
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


BATCH_ROWS = 4096
"""The rows read at once."""


class Column(NamedTuple):
    """One column of a dataset's file."""

    name: str
    feature: dict[str, Any]
    """The feature, as the library `datasets` describes it in Parquet files and cards."""
    meaning: str
    values: Callable[[Episode], list[Any]] | None = None
    """Returns the values in the T + 1 rows of an episode, for a column of numbers or booleans of
    the rows: what is written, hashed and checked."""

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

    @classmethod
    def of(cls, *columns: tuple[Any, ...]) -> Columns:
        """Return columns, each given by the fields of `Column`.

        In place of its feature, a column may have the name of a type, such as `int32`, `string` or
        `Image`.
        """

        def column(name: str, feature: str | dict[str, Any], *rest: Any) -> Column:
            if feature == "Image":
                feature = {"_type": "Image"}
            elif isinstance(feature, str):
                feature = {"dtype": feature, "_type": "Value"}
            return Column(name, feature, *rest)

        return cls(starmap(column, columns))

    def opened(self, source: Path | BinaryIO, **options: Any) -> ParquetFile:
        """Open a Parquet file, whose texts and pictures are read dictionary-encoded.

        A few bytes of a file may repeat a value of megabytes in thousands of rows. Encoded, each
        value is in memory once.

        Args:
            source: The file, which may lack some of the columns.
            **options: Arguments of `ParquetFile`.

        Raises:
            OSError, ArrowException: The file cannot be read.
        """
        import pyarrow.parquet as pq

        with pq.ParquetFile(source) as file:
            footer = file.metadata
        held = set()
        if footer.num_row_groups:  # Not from `footer.schema`, which makes a cycle of references.
            group = footer.row_group(0)
            held = {group.column(number).path_in_schema for number in range(group.num_columns)}
        texts = [column.name for column in self if column.type == "string"]
        for column in self:
            if column.type == "Image":
                texts += [f"{column.name}.bytes", f"{column.name}.path"]
        encoded = [name for name in texts if name in held]
        try:
            return pq.ParquetFile(source, metadata=footer, read_dictionary=encoded, **options)
        except KeyError as error:
            raise OSError(f"its footer names a column that it has not: {error}") from error

    def values_in(self, file: ParquetFile) -> Iterator[dict[str, list[Any]]]:
        """Yield the values of all columns, some rows at a time.

        Equal values of a batch of texts or pictures are one object. A picture has two entries, such
        as `obs.bytes` and `obs.path`.
        """
        import pyarrow.compute as pc

        for group in range(file.num_row_groups):
            # A row group is read at once, unless it has very many rows.
            for batch in file.iter_batches(BATCH_ROWS, [group]):
                values = {}
                for column in self:
                    array = batch[column.name]
                    if column.type == "Image":
                        for name in ("bytes", "path"):
                            part = pc.struct_field(array, name)
                            values[f"{column.name}.{name}"] = values_of(part)
                            del part
                    else:
                        values[column.name] = values_of(array)
                    del array
                del batch  # It holds the pictures a second time.
                yield values

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
            [(column.name, types[column.type]) for column in self],
            metadata={"huggingface": json.dumps(features)},
        )


COLUMNS = Columns.of(
    ("obs", "Image", "picture of the state, 600 x 600 RGB, PNG"),
    (
        "actions",
        {"names": [action.name.lower() for action in Action], "_type": "ClassLabel"},
        "action taken: 0 up, 1 right, 2 down, 3 left; -1 in the last row of an episode",
        lambda episode: [*episode.actions.tolist(), NO_ACTION],
    ),
    (
        "rewards",
        "float32",
        "reward received for the action; 0 in the last row of an episode",
        lambda episode: [*episode.rewards.tolist(), 0.0],
    ),
    (
        "episode_starts",
        "bool",
        "whether the row is the first of an episode",
        lambda episode: [True, *repeat(False, len(episode))],
    ),
    ("info", "string", "the labyrinth, in the text language that loads it again"),
)
"""The columns of the rows."""

_NAMED = ("actions", "rewards", "episode_starts")
OTHERS = tuple(column for column in COLUMNS.numbers if column.name not in _NAMED)
"""Those without a field of their own in `LoadedEpisode` and `Transitions`."""

TABLE_COLUMNS = Columns.of(
    # Text, since numbers of JSON and JavaScript cannot hold sixteen hexadecimal digits.
    ("labyrinth_id", "string", "hash of the labyrinth, sixteen hexadecimal digits"),
    ("structure_id", "string", "hash of its structure, likewise"),
    ("split", "string", "split that it is in"),
    ("parent_id", "string", "labyrinth that it was derived from; null if from none"),
    ("height", "int32", "rows of cells"),
    ("width", "int32", "columns of cells"),
    ("task", "string", "task, such as navigation"),
    ("start", "int32", "cell of the start: row * width + column, row 0 at the bottom"),
    ("goal", "int32", "cell of the goal, likewise"),
    ("moves", "int32", "moves on a shortest route"),
    ("optimal_routes", "int64", "shortest routes; 2**63 - 1 stands for that many or more"),
    ("turns", "int32", "changes of direction on its first route; null in random"),
    ("loops", "int32", "passages beyond those of a tree"),
    ("branching", "int32", "cells with three or four passages"),
    ("dead_ends", "int32", "cells with one passage"),
    ("episodes", "int32", "episodes in the split"),
    ("first_row", "int64", "its first row in the split, counted from 0"),
    ("rows", "int32", "rows in the split, which follow one another"),
    ("optimal_actions", "int32", "actions in its episodes that begin a shortest route"),
)
"""The columns of the table of labyrinths, one row per labyrinth; see `Manifest.TABLE`."""


def values_of(column: pa.Array) -> list[Any]:
    """Return the values of a column; equal values of a dictionary are one object."""
    import pyarrow as pa

    if not pa.types.is_dictionary(column.type):
        values: list[Any] = column.to_pylist()
        return values
    distinct = [*column.dictionary.to_pylist(), None]
    return [distinct[-1 if index is None else index] for index in column.indices.to_pylist()]

"""The table of labyrinths, `labyrinths.parquet` in a dataset's folder: one row for each labyrinth.

Its rows are in the order of the splits and of their rows. On the Hub it is a config of its own,
such as `5x5-labyrinths`.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from labyrinth_core.data.columns import Column
from labyrinth_core.data.errors import DatasetError, one_line
from labyrinth_core.data.manifest import Manifest
from labyrinth_core.data.storage import AnyPath, file_sha256, local_copy

TABLE = "labyrinths.parquet"
"""The name of the file."""

SPLIT = "labyrinths"
"""What the Hub's tools have to call a split: the table has none, as its rows are of all splits."""

MOST_ROUTES = 2**63 - 1
"""The largest number of routes in the table; it stands for all that are larger, too."""


TABLE_COLUMNS = (
    # As text, since sixteen digits are more than the numbers of JSON and JavaScript can hold.
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
    Column.of("optimal_routes", "int64", "shortest routes; 2**63 - 1 stands for that many or more"),
    Column.of("turns", "int32", "changes of direction on its first route; null in random"),
    Column.of("loops", "int32", "passages beyond those of a tree"),
    Column.of("branching", "int32", "cells with three or four passages"),
    Column.of("dead_ends", "int32", "cells with one passage"),
    Column.of("episodes", "int32", "episodes in the split"),
    Column.of("first_row", "int64", "its first row in the split, counted from 0"),
    Column.of("rows", "int32", "rows in the split, which follow one another"),
    Column.of("optimal_actions", "int32", "actions in its episodes that begin a shortest route"),
)


def table_config(config: str) -> str:
    """Return the name that the table of a config has on the Hub."""
    return f"{config}-{SPLIT}"


@contextmanager
def table_file(folder: AnyPath, manifest: Manifest) -> Iterator[Path]:
    """Lend the table of a dataset as a local file, after comparing it with the manifest.

    Raises:
        DatasetError: The table is missing or damaged, or the caller cannot read it.
    """
    import pyarrow as pa

    path = folder / TABLE
    try:
        with local_copy(path) as local:
            if file_sha256(local) != manifest.table.sha256:
                raise DatasetError(f"{path} is damaged: its sha256 is not the manifest's")
            yield local
    except (OSError, pa.ArrowException) as error:
        raise DatasetError(f"{path} cannot be read: {one_line(error)}") from error


def table_rows(folder: AnyPath, manifest: Manifest) -> Iterator[dict[str, Any]]:
    """Yield the rows of the table of a dataset; raise as `table_file` does."""
    import pyarrow.parquet as pq

    with table_file(folder, manifest) as path, pq.ParquetFile(path) as file:
        for batch in file.iter_batches():
            yield from batch.to_pylist()

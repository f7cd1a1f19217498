"""Check and read the table of labyrinths."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING

from labyrinth_core.data.format import TABLE_COLUMNS
from labyrinth_core.data.manifest import AGAIN, Manifest, mended, readable, unless_replaced
from labyrinth_core.errors import DatasetError
from labyrinth_core.storage import AnyPath, File

if TYPE_CHECKING:
    import pyarrow as pa
    import pyarrow.parquet

_TABLE_KINDS = {column.name: column.feature["dtype"] for column in TABLE_COLUMNS}

MOST_TEXT, MOST_TABLE_BYTES = 99, 1000
"""The most bytes of a text in the table of labyrinths; of a row, on average over a row group."""


@contextmanager
def table_file(folder: AnyPath, manifest: Manifest) -> Iterator[pyarrow.parquet.ParquetFile]:
    """Check and open the table of labyrinths, whose texts are read dictionary-encoded.

    Raises:
        DatasetError: The table is missing or damaged, or the caller cannot read it.
    """
    path = folder / Manifest.TABLE
    with unless_replaced(folder, manifest.table), ExitStack() as stack:
        with readable(path):
            local = stack.enter_context(File(path).local_copy())

        def check() -> int:
            with readable(path):
                digest, size = File(local).sha256(), local.stat().st_size
            if digest != manifest.table.sha256:
                raise DatasetError(f"{path} is damaged: its sha256 is not the manifest's; {AGAIN}")
            return size

        size = mended(path, check)
        with readable(path):
            file = stack.enter_context(TABLE_COLUMNS.opened(local))
        if problem := table_problem(file, manifest, size):
            raise DatasetError(f"{path} is damaged: {problem}")
        yield file


def table_problem(file: pyarrow.parquet.ParquetFile, manifest: Manifest, size: int) -> str | None:
    """Return why a file cannot be the table of a dataset, before any row is read; None if it can.

    Args:
        file: The file.
        manifest: The manifest of the dataset.
        size: The size of the file in bytes.
    """
    kinds = {
        field.name: str(getattr(field.type, "value_type", field.type))
        for field in file.schema_arrow
    }
    if kinds != _TABLE_KINDS:
        return "its columns are not those of a table of labyrinths"
    rows, footer = sum(shard.labyrinths for shard in manifest.shards), file.metadata
    groups = [footer.row_group(number) for number in range(footer.num_row_groups)]
    if not rows == footer.num_rows == sum(group.num_rows for group in groups):
        return f"{footer.num_rows} rows, but the manifest has {rows} labyrinths"
    if rows > size:  # The ids alone take more.
        return f"{rows} rows in {size} bytes"
    if any(group.total_byte_size > MOST_TABLE_BYTES * (group.num_rows + 99) for group in groups):
        return f"a row group has more than {MOST_TABLE_BYTES} bytes a row"
    return None


def table_groups(
    folder: AnyPath, manifest: Manifest, columns: Sequence[str] | None = None
) -> Iterator[pa.Table]:
    """Yield the row groups of the table of labyrinths, all columns or some.

    Raises:
        DatasetError: The table is missing or damaged, or the caller cannot read it.
    """
    with table_file(folder, manifest) as file:
        for group in range(file.num_row_groups):
            with readable(folder / Manifest.TABLE):
                table = file.read_row_group(group, columns)
            yield decoded(table)


def decoded(table: pa.Table) -> pa.Table:
    """Return rows of the table of labyrinths with plain texts; raise DatasetError if one is long.

    A few bytes may repeat a text of megabytes in every row.
    """
    import pyarrow as pa
    import pyarrow.compute as pc

    for index, name in enumerate(table.column_names):
        column = table[name]
        if pa.types.is_dictionary(column.type):
            lengths = (
                pc.max(pc.binary_length(chunk.dictionary)).as_py() for chunk in column.chunks
            )
            if max((length or 0 for length in lengths), default=0) > MOST_TEXT:
                raise DatasetError(
                    f"{Manifest.TABLE} {name}: a text has more than {MOST_TEXT} bytes"
                )
            table = table.set_column(index, name, column.cast(pa.string()))
    return table

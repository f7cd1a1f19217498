"""The table of labyrinths: check and read it, and select labyrinths of a split by it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.checks import whole
from labyrinth_core.data.format import TABLE_COLUMNS
from labyrinth_core.data.manifest import AGAIN, Manifest, Shard, mended, readable, unless_replaced
from labyrinth_core.errors import DatasetError
from labyrinth_core.storage import AnyPath, File

if TYPE_CHECKING:
    import pyarrow as pa
    import pyarrow.parquet
    from pyarrow.compute import Expression

_TABLE_KINDS = {column.name: column.feature["dtype"] for column in TABLE_COLUMNS}

MOST_TEXT, MOST_TABLE_BYTES = 99, 1000
"""The most bytes of a text in the table of labyrinths; of a row, on average over a row group."""

Spans = tuple[NDArray[np.int64], NDArray[np.int64]]
"""The first row in the split and the number of rows of each of some labyrinths, in order."""

Filter: TypeAlias = "Expression"
"""A filter of the table of labyrinths, such as `pyarrow.compute.field("moves") >= 12`."""


class Step(NamedTuple):
    """One step in choosing labyrinths of a split."""

    where: Filter | None
    """The labyrinths that pass this filter; None for all."""
    keep: Any = None
    """How many of these, the first ones, or their indices in ascending order; None for all."""


@dataclass(frozen=True)
class LabyrinthTable:
    """The table of labyrinths of a dataset: a file, and the manifest that describes it."""

    folder: AnyPath
    """The folder of the file."""
    manifest: Manifest

    @contextmanager
    def opened(self) -> Iterator[pyarrow.parquet.ParquetFile]:
        """Check and open the table, whose texts are read dictionary-encoded.

        Raises:
            DatasetError: The table is missing or damaged, or the caller cannot read it.
        """
        path, manifest = self.folder / Manifest.TABLE, self.manifest
        with unless_replaced(self.folder, manifest.table), ExitStack() as stack:
            with readable(path):
                local = stack.enter_context(File(path).local_copy())

            def check() -> int:
                with readable(path):
                    digest, size = File(local).sha256(), local.stat().st_size
                if digest != manifest.table.sha256:
                    raise DatasetError(
                        f"{path} is damaged: its sha256 is not the manifest's; {AGAIN}"
                    )
                return size

            size = mended(path, check)
            with readable(path):
                file = stack.enter_context(TABLE_COLUMNS.opened(local))
            if problem := table_problem(file, manifest, size):
                raise DatasetError(f"{path} is damaged: {problem}")
            yield file

    def groups(self, columns: Sequence[str] | None = None) -> Iterator[pa.Table]:
        """Yield the row groups of the table, all columns or some.

        Raises:
            DatasetError: The table is missing or damaged, or the caller cannot read it.
        """
        with self.opened() as file:
            for group in range(file.num_row_groups):
                with readable(self.folder / Manifest.TABLE):
                    table = file.read_row_group(group, columns)
                yield decoded(table)

    def select(self, split: str, steps: Sequence[Step]) -> Spans:
        """Return the rows of the chosen labyrinths of a split.

        Args:
            split: The name of the split.
            steps: How labyrinths are chosen.

        Raises:
            ValueError: There are fewer labyrinths, or a filter cannot be applied.
            DatasetError: The table is missing or damaged, or does not match the shards.
        """
        firsts, rows = self.chosen(split, steps, ("first_row", "rows"))
        ends = ends_of(self.manifest.of(split))
        # Each labyrinth is in one shard, and none overlaps another.
        shard = np.searchsorted(ends, firsts, "right")
        last = np.append(firsts[1:], ends[-1])
        fits = (firsts >= 0) & (rows > 0) & (shard < len(ends)) & (rows <= last - firsts)
        if not (fits.all() and (rows <= ends[shard] - firsts).all()):
            raise unlike_shards(split)
        return firsts, rows

    def chosen(
        self, split: str, steps: Sequence[Step], columns: Sequence[str]
    ) -> list[NDArray[np.int64]]:
        """Return columns of whole numbers for the chosen labyrinths; see `select`.

        A missing value becomes -1, which no column has.
        """
        import pyarrow as pa
        import pyarrow.compute as pc

        for where, _ in steps:
            if where is not None and not isinstance(where, pc.Expression):
                raise ValueError(
                    f"where={where!r:.99}: give an expression, such as "
                    "pyarrow.compute.field('moves') >= 12"
                )
        names = [column.name for column in TABLE_COLUMNS]
        filters = [str(where) for where, _ in steps]
        read = {
            "split",
            *columns,
            *(name for name in names if any(name in shown for shown in filters)),
        }
        table = pa.concat_tables(
            group.filter(pc.field("split") == split) for group in self.groups(sorted(read))
        )
        for number, (where, keep) in enumerate(steps):
            of = "the selection" if number else f"split={split}"
            if where is not None:
                try:
                    table = table.filter(where)
                except pa.ArrowException as error:
                    reason = str(error).partition(" in ")[0].partition("\n")[0]
                    raise ValueError(
                        f"where={where}: {reason}; the columns of {Manifest.TABLE} are "
                        f"{', '.join(names)}"
                    ) from error
                if not len(table):
                    raise ValueError(f"where={where}: {of} has no such labyrinth")
            if isinstance(keep, np.ndarray):
                table = table.take(keep)
            elif keep is not None:
                filtered = "" if where is None else f" where {where}"
                count = len(table)
                held = f"a whole number from 1 to {count}, as many as {of} has{filtered}"
                table = table.slice(0, whole("labyrinths", keep, 1, count, allowed=held))
        values = (pc.fill_null(table[name], -1) for name in columns)
        return [column.to_numpy().astype(np.int64) for column in values]


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


def ends_of(shards: Sequence[Shard]) -> NDArray[np.int64]:
    """Return the row of the split at which each shard ends, exclusive."""
    return np.cumsum([shard.rows for shard in shards])


def unlike_shards(split: str) -> DatasetError:
    """Return the error for a table of labyrinths that does not match the shards of a split."""
    return DatasetError(f"{Manifest.TABLE} does not match the shards of split={split}")

"""Select labyrinths of a split by the table of labyrinths."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.checks import whole
from labyrinth_core.data.format import TABLE_COLUMNS
from labyrinth_core.data.manifest import Manifest, Shard
from labyrinth_core.data.table import table_groups
from labyrinth_core.errors import DatasetError
from labyrinth_core.storage import AnyPath

if TYPE_CHECKING:
    from pyarrow.compute import Expression

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


def ends_of(shards: Sequence[Shard]) -> NDArray[np.int64]:
    """Return the row of the split at which each shard ends, exclusive."""
    return np.cumsum([shard.rows for shard in shards])


def select(folder: AnyPath, manifest: Manifest, split: str, steps: Sequence[Step]) -> Spans:
    """Return the rows of the chosen labyrinths of a split.

    Args:
        folder: The folder of the table of labyrinths.
        manifest: The manifest of the dataset.
        split: The name of the split.
        steps: How labyrinths are chosen.

    Raises:
        ValueError: There are fewer labyrinths, or a filter cannot be applied.
        DatasetError: The table is missing or damaged, or does not match the shards.
    """
    firsts, rows = chosen(folder, manifest, split, steps, ("first_row", "rows"))
    ends = ends_of(manifest.of(split))
    # Each labyrinth is in one shard, and none overlaps another.
    shard = np.searchsorted(ends, firsts, "right")
    last = np.append(firsts[1:], ends[-1])
    fits = (firsts >= 0) & (rows > 0) & (shard < len(ends)) & (rows <= last - firsts)
    if not (fits.all() and (rows <= ends[shard] - firsts).all()):
        raise unlike_shards(split)
    return firsts, rows


def unlike_shards(split: str) -> DatasetError:
    """Return the error for a table of labyrinths that does not match the shards of a split."""
    return DatasetError(f"{Manifest.TABLE} does not match the shards of split={split}")


def chosen(
    folder: AnyPath,
    manifest: Manifest,
    split: str,
    steps: Sequence[Step],
    columns: Sequence[str],
) -> list[NDArray[np.int64]]:
    """Return columns of whole numbers of the table for the chosen labyrinths; see `select`.

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
    read = {"split", *columns, *(name for name in names if any(name in shown for shown in filters))}
    table = pa.concat_tables(
        group.filter(pc.field("split") == split)
        for group in table_groups(folder, manifest, sorted(read))
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

"""Select labyrinths of a split by the table of labyrinths."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.data.errors import DatasetError
from labyrinth_core.data.format import TABLE_COLUMNS
from labyrinth_core.data.manifest import TABLE, Manifest, Shard, table_groups
from labyrinth_core.data.storage import AnyPath
from labyrinth_core.world.labyrinth import whole

if TYPE_CHECKING:
    from pyarrow.compute import Expression

Spans = tuple[NDArray[np.int64], NDArray[np.int64]]
"""The first row in the split and the number of rows of each of some labyrinths, in order."""

Filter: TypeAlias = "Expression"
"""A filter of the table of labyrinths, such as `pyarrow.compute.field("moves") >= 12`."""


def ends_of(shards: Sequence[Shard]) -> NDArray[np.int64]:
    """Return the row of the split at which each shard ends, exclusive."""
    return np.cumsum([shard.rows for shard in shards])


def select(
    folder: AnyPath, manifest: Manifest, split: str, labyrinths: Any, where: Filter | None
) -> Spans:
    """Return the rows of the requested labyrinths of a split.

    Args:
        folder: The folder of the table of labyrinths.
        manifest: The manifest of the dataset.
        split: The name of the split.
        labyrinths: How many, the first ones; None for all.
        where: A filter of the table, or None.

    Raises:
        ValueError: There are fewer labyrinths, or the filter cannot be applied.
        DatasetError: The table is missing or damaged, or does not match the shards.
    """
    firsts, rows = _filtered(folder, manifest, split, where)
    if labyrinths is not None:
        filtered = "" if where is None else f" where {where}"
        count = len(firsts)
        held = f"a whole number from 1 to {count}, as many as split={split} has{filtered}"
        labyrinths = whole("labyrinths", labyrinths, 1, count, allowed=held)
    firsts, rows = firsts[:labyrinths], rows[:labyrinths]
    ends = ends_of(manifest.of(split))
    # Each labyrinth is in one shard, and none overlaps another.
    shard = np.searchsorted(ends, firsts, "right")
    last = np.append(firsts[1:], ends[-1])
    fits = (firsts >= 0) & (rows > 0) & (shard < len(ends)) & (rows <= last - firsts)
    if not (fits.all() and (rows <= ends[shard] - firsts).all()):
        raise DatasetError(f"{TABLE} does not match the shards of split={split}")
    return firsts, rows


def _filtered(folder: AnyPath, manifest: Manifest, split: str, where: Filter | None) -> Spans:
    """Return the rows of each labyrinth that passes the filter."""
    import pyarrow as pa
    import pyarrow.compute as pc

    if where is not None and not isinstance(where, pc.Expression):
        raise ValueError(
            f"where={where!r:.99}: give an expression, such as pyarrow.compute.field('moves') >= 12"
        )
    names = [column.name for column in TABLE_COLUMNS]
    read = {"split", "first_row", "rows", *(name for name in names if name in str(where))}
    table = pa.concat_tables(
        group.filter(pc.field("split") == split)
        for group in table_groups(folder, manifest, sorted(read))
    )
    if where is not None:
        try:
            table = table.filter(where)
        except pa.ArrowException as error:
            reason = str(error).partition(" in ")[0].partition("\n")[0]
            raise ValueError(
                f"where={where}: {reason}; the columns of {TABLE} are {', '.join(names)}"
            ) from error
        if not len(table):
            raise ValueError(f"where={where}: split={split} has no such labyrinth")
    # A missing value becomes a number that no row has.
    firsts, rows = (pc.fill_null(table[name], -1) for name in ("first_row", "rows"))
    return firsts.to_numpy().astype(np.int64), rows.to_numpy().astype(np.int64)

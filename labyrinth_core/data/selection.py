"""A split of a dataset, or some of its labyrinths: the first so many, or those a filter leaves."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import chain, groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.data.errors import DatasetError
from labyrinth_core.data.labyrinth_table import TABLE, TABLE_COLUMNS, table_file
from labyrinth_core.data.manifest import Manifest, Shard
from labyrinth_core.data.row_arrays import Columns, columns_of, read_columns
from labyrinth_core.data.source import RawRow, locate, read_rows
from labyrinth_core.data.storage import AnyPath
from labyrinth_core.language.text import without_agent

if TYPE_CHECKING:
    from pyarrow.compute import Expression

Filter: TypeAlias = "Expression"
"""A filter of the table of labyrinths, such as `pyarrow.compute.field("moves") >= 12`."""

Numbers = NDArray[np.int64]
"""The numbers of some labyrinths, ascending; the first of a split or of a shard has 0."""


@dataclass(frozen=True, eq=False)
class Part:
    """A split, or some labyrinths of it, in a folder."""

    folder: AnyPath
    config: str
    """The name of its config."""
    shards: Sequence[Shard]
    """The shards that hold some of it."""
    numbers: Sequence[Numbers | None]
    """The labyrinths in each of the shards; None for all."""

    def rows(self, *, pictures: bool) -> Iterator[RawRow]:
        """Return its rows; what can be wrong with them is raised as they are read."""
        held = zip(self.shards, self.numbers, strict=True)
        return chain.from_iterable(
            rows_of(read_rows(self.folder, [shard], pictures=pictures), numbers)
            for shard, numbers in held
        )

    def columns(self) -> Columns | None:
        """Return the columns of its rows; None if `rows` has to read them, or to say what is wrong.

        Texts of labyrinths that it does not have may be among them.
        """
        parts: list[Columns] = []
        texts: dict[str, int] = {}
        for shard, numbers in zip(self.shards, self.numbers, strict=True):
            most = None if numbers is None else int(numbers[-1]) + 1
            try:
                columns = read_columns(self.folder, shard, most)
            except DatasetError:
                return None
            if columns is None:
                return None
            if numbers is not None:
                columns = columns_of(columns, numbers)
            here = [texts.setdefault(text, len(texts)) for text in columns.texts]
            parts.append(columns._replace(info=np.array(here, np.int64)[columns.info]))
        return Columns(
            np.concatenate([part.actions for part in parts]),
            np.concatenate([part.rewards for part in parts]),
            np.concatenate([part.episode_starts for part in parts]),
            np.concatenate([part.info for part in parts]),
            list(texts),
        )


def find_part(
    source: str | Path,
    config: str,
    split: str,
    revision: str | None = None,
    labyrinths: int | None = None,
    where: Filter | None = None,
) -> Part:
    """Return a split or a part of it; from the Hub come only the shards that hold some of it.

    For arguments and errors see `loader.load_episodes`.
    """
    numbers = find_numbers(source, config, split, revision, labyrinths, where)
    if numbers is None:
        folder = locate(source, config, [f"{split}-*.parquet"], revision)
        manifest = Manifest.read(folder)
        shards = manifest.of(split)
        return Part(folder, manifest.config.name, shards, [None] * len(shards))
    manifest = Manifest.read(locate(source, config, [], revision))
    shards = manifest.of(split)
    counts = np.array([shard.labyrinths for shard in shards])
    ends = np.cumsum(counts)
    parts = np.split(numbers, np.searchsorted(numbers, ends))[: len(shards)]
    held = [n for n, part in enumerate(parts) if len(part)]
    shards = [shards[n] for n in held]
    folder = locate(source, config, [shard.path for shard in shards], revision)
    within = [parts[n] - (ends - counts)[n] for n in held]
    return Part(folder, manifest.config.name, shards, within)


def find_numbers(
    source: str | Path,
    config: str,
    split: str,
    revision: str | None = None,
    labyrinths: int | None = None,
    where: Filter | None = None,
) -> Numbers | None:
    """Return the numbers of the labyrinths of a split that are asked for, None if all are.

    For arguments and errors see `loader.load_episodes`.
    """
    if labyrinths is None and where is None:
        return None
    folder = locate(source, config, [] if where is None else [TABLE], revision)
    manifest = Manifest.read(folder)
    count = sum(shard.labyrinths for shard in manifest.of(split))
    numbers = np.arange(count) if where is None else _filtered(folder, manifest, split, where)
    if labyrinths is not None:
        whole = isinstance(labyrinths, int | np.integer) and not isinstance(labyrinths, bool)
        if not whole or not 1 <= labyrinths <= len(numbers):
            filtered = "" if where is None else f" where {where}"
            raise ValueError(
                f"labyrinths={labyrinths!r:.99}: give a whole number from 1 to {len(numbers)}, as "
                f"many as split={split} has{filtered}"
            )
        numbers = numbers[:labyrinths]
    return None if len(numbers) == count else numbers


def _filtered(folder: AnyPath, manifest: Manifest, split: str, where: Any) -> Numbers:
    import pyarrow as pa
    import pyarrow.compute as pc
    import pyarrow.parquet as pq

    if not isinstance(where, pc.Expression):
        raise ValueError(
            f"where={where!r:.99}: give an expression, such as pyarrow.compute.field('moves') >= 12"
        )
    own = pc.field("split") == split
    with table_file(folder, manifest) as path:
        every = pq.read_table(path, columns=["first_row"], filters=own)["first_row"].to_numpy()
        try:
            kept = pq.read_table(path, columns=["first_row"], filters=own & where)
        except pa.ArrowException as error:
            reason = str(error).partition(" in ")[0].partition("\n")[0]
            columns = ", ".join(column.name for column in TABLE_COLUMNS)
            raise ValueError(
                f"where={where}: {reason}; the columns of {TABLE} are {columns}"
            ) from error
    # A first row tells a labyrinth, as they are in the order of the rows.
    numbers: Numbers = np.searchsorted(every, kept["first_row"].to_numpy())
    if not len(numbers):
        raise ValueError(f"where={where}: split={split} has no such labyrinth")
    return numbers


def rows_of(rows: Iterable[RawRow], numbers: Numbers | None) -> Iterator[RawRow]:
    """Yield the rows of some labyrinths, reading no labyrinth after the last of them.

    Args:
        rows: The rows of whole labyrinths, of which the first has the number 0.
        numbers: The labyrinths; None for all.
    """
    if numbers is None:
        yield from rows
        return
    labyrinths = enumerate(groupby(rows, lambda row: without_agent(row.info)))
    for wanted in numbers.tolist():
        yield from next((own for number, (_, own) in labyrinths if number == wanted), ())

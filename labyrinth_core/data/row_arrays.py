"""The rows of a shard as arrays, read at once."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.data.columns import tables_of
from labyrinth_core.data.manifest import Shard
from labyrinth_core.data.source import TYPES, opened
from labyrinth_core.data.storage import AnyPath
from labyrinth_core.language.text import without_agent


class Columns(NamedTuple):
    """The columns of n rows, but for the pictures."""

    actions: NDArray[np.int64]
    rewards: NDArray[np.float32]
    episode_starts: NDArray[np.bool_]
    info: NDArray[np.int64]
    """The number in `texts` of each row's text, shape (n,)."""
    texts: list[str]
    """The texts of `info`, which all differ, in the order in which they come first."""

    def take(self, rows: NDArray[np.bool_]) -> Columns:
        """Return some of the rows; texts that none of them has remain."""
        actions, rewards, starts = self.actions[rows], self.rewards[rows], self.episode_starts[rows]
        return Columns(actions, rewards, starts, self.info[rows], self.texts)


def read_columns(folder: AnyPath, shard: Shard, labyrinths: int | None) -> Columns | None:
    """Return the columns of a shard that is what its manifest says.

    Args:
        folder: The folder of the manifest.
        shard: The shard.
        labyrinths: How many labyrinths are needed, the first ones; there may be more. None for all.

    Returns:
        None if a column is missing, or of another type than ours, or has a value missing.

    Raises:
        DatasetError: As `source.read_rows`.
    """
    import pyarrow as pa

    kinds = pa.types.is_int64, pa.types.is_float32, pa.types.is_boolean, pa.types.is_dictionary
    numbers: dict[str, int] = {}
    found: set[str] = set()
    parts: list[list[NDArray[Any]]] = []
    with opened(folder, shard) as file:
        for table in tables_of(file, [*TYPES], together=64):
            if table.column_names != [*TYPES] or any(
                column.null_count or not of_kind(column.type)
                for column, of_kind in zip(table.columns, kinds, strict=True)
            ):
                return None
            (info,) = table["info"].chunks
            values = info.dictionary.to_pylist()
            here = np.array([numbers.setdefault(text, len(numbers)) for text in values], np.int64)
            plain = [table[name].to_numpy() for name in ("actions", "rewards", "episode_starts")]
            parts.append([*plain, here[info.indices.to_numpy()]])
            if labyrinths is not None:
                found.update(map(without_agent, values))
                if len(found) > labyrinths:
                    break
    if not parts:
        return None
    actions, rewards, starts, texts = map(np.concatenate, zip(*parts, strict=True))
    return Columns(actions, rewards, starts, texts, list(numbers))


def columns_of(columns: Columns, numbers: NDArray[np.int64]) -> Columns:
    """Return the columns of the rows of some labyrinths; see `selection.rows_of`."""
    places: dict[str, int] = {}
    bare = [places.setdefault(without_agent(text), len(places)) for text in columns.texts]
    labyrinths = np.array(bare)[columns.info]
    kept = np.isin(np.cumsum(np.diff(labyrinths, prepend=labyrinths[:1]) != 0), numbers)
    return columns.take(kept)

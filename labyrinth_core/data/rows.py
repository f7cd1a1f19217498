"""The rows of shards and streams as arrays, and the episodes that they make."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from itertools import islice
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.data.columns import NO_ACTION, footer_problem, open_shard, tables_of
from labyrinth_core.data.errors import DatasetError, one_line
from labyrinth_core.data.manifest import Shard
from labyrinth_core.data.storage import AnyPath, RemotePath, file_sha256, local_copy
from labyrinth_core.language.text import without_agent

if TYPE_CHECKING:
    import pyarrow as pa
    import pyarrow.parquet

TYPES = {"actions": int, "rewards": float, "episode_starts": bool, "info": str}
"""Column -> the type of its values, without the pictures."""

TOGETHER = 64
"""Row groups that are read together without pictures: many texts are parsed in less time."""


class Rows(NamedTuple):
    """Consecutive rows of a dataset, n of them."""

    actions: NDArray[np.int64]
    rewards: NDArray[np.float32]
    episode_starts: NDArray[np.bool_]
    info: NDArray[np.int64]
    """The number in `texts` of each row's text, shape (n,)."""
    texts: list[str]
    """The texts of `info`, which all differ, in the order of their first rows; perhaps others."""
    pngs: NDArray[np.object_] | None
    """The picture of each row, bytes or None, shape (n,); None if no pictures were read."""

    def take(self, rows: slice | NDArray[Any]) -> Rows:
        """Return some of the rows."""
        pngs = None if self.pngs is None else self.pngs[rows]
        columns = self.actions[rows], self.rewards[rows], self.episode_starts[rows]
        return Rows(*columns, self.info[rows], self.texts, pngs)


def joined(blocks: Sequence[Rows]) -> Rows:
    """Return consecutive rows as one block, with the texts that they use."""
    if len(blocks) == 1:
        return blocks[0]
    texts: dict[str, int] = {}
    info = []
    for block in blocks:
        used, which = np.unique(block.info, return_inverse=True)
        own = [block.texts[place] for place in used.tolist()]
        numbers = [texts.setdefault(text, len(texts)) for text in own]
        info.append(np.array(numbers, np.int64)[which])
    pngs = [block.pngs for block in blocks if block.pngs is not None]
    return Rows(
        np.concatenate([block.actions for block in blocks]),
        np.concatenate([block.rewards for block in blocks]),
        np.concatenate([block.episode_starts for block in blocks]),
        np.concatenate(info),
        list(texts),
        np.concatenate(pngs) if pngs else None,
    )


def read_rows(folder: AnyPath, shards: Iterable[Shard], *, pictures: bool) -> Iterator[Rows]:
    """Yield the rows of shards, after checking that each is the file that the manifest describes.

    Raises:
        DatasetError: A shard is missing or damaged, or not the one that the manifest describes.
    """
    for shard in shards:
        with opened(folder, shard) as file:
            yield from rows_together(file, pictures=pictures)


def rows_together(file: pyarrow.parquet.ParquetFile, *, pictures: bool) -> Iterator[Rows]:
    """Yield the rows of a shard, without pictures those of `TOGETHER` row groups at once."""
    together = 1 if pictures else TOGETHER
    tables = tables_of(file, columns_read(pictures), together=together)
    blocks = (rows_of_table(table, pictures=pictures) for table in tables)
    while some := list(islice(blocks, together)):
        yield joined(some)


def columns_read(pictures: bool) -> list[str]:
    """Return the names of the columns that rows are read from."""
    return [*TYPES, "obs.bytes"] if pictures else [*TYPES]


@contextmanager
def opened(folder: AnyPath, shard: Shard) -> Iterator[pyarrow.parquet.ParquetFile]:
    """Open a shard after checking it; an error within means that it cannot be read."""
    path = folder / shard.path
    with readable(path), local_copy(path) as local:
        check_file(local, shard, path)
        with open_shard(local) as file:
            check_footer(file, shard, path)
            yield file


@contextmanager
def opened_in_place(path: RemotePath, shard: Shard) -> Iterator[pyarrow.parquet.ParquetFile]:
    """Open a shard of which only the ranges that are read are downloaded; check its footer alone.

    An error within means that it cannot be read.
    """
    import pyarrow.parquet as pq

    with readable(path), path.open_ranges() as ranges:
        file = pq.ParquetFile(ranges, pre_buffer=True, read_dictionary=["info"])
        check_footer(file, shard, path)
        yield file


def check_footer(file: pyarrow.parquet.ParquetFile, shard: Shard, path: AnyPath) -> None:
    """Raise DatasetError if the footer of a file is not that of the shard."""
    problem = footer_problem(file, shard.rows)
    if problem is not None:
        raise DatasetError(f"{path} is damaged: {problem}")


def check_file(file: AnyPath, shard: Shard, path: AnyPath) -> None:
    """Raise DatasetError if a file, a shard or a copy of it, has another SHA-256 than the shard."""
    if file_sha256(file) != shard.sha256:
        raise DatasetError(
            f"{path} is damaged: its sha256 is not the manifest's; "
            "delete it, and build or download it again"
        )


@contextmanager
def readable(place: object) -> Iterator[None]:
    """Raise DatasetError for an error within that says that files at a place cannot be read."""
    import pyarrow as pa

    try:
        yield
    except MemoryError:  # Arrow's, too; nothing is wrong with the files.
        raise
    except (OSError, ValueError, LookupError, pa.ArrowException) as error:
        raise DatasetError(f"{place} cannot be read: {one_line(error)}") from error


def rows_of_table(table: pa.Table, *, pictures: bool) -> Rows:
    """Return the rows of a table; raise DatasetError for a value that is missing or of other type.

    A table without the column `obs` has no pictures.
    """
    import pyarrow as pa
    import pyarrow.compute as pc

    types = pa.types
    kinds = {
        "actions": types.is_integer,
        "rewards": types.is_floating,
        "episode_starts": types.is_boolean,
        "info": lambda each: types.is_string(each) or types.is_large_string(each),
    }
    columns = {}
    for name, of_kind in kinds.items():
        column = pa.chunked_array([pa.nulls(len(table))])
        if name in table.column_names:
            column = table[name]
        kind = column.type.value_type if types.is_dictionary(column.type) else column.type
        missing = column.filter(column.is_null())
        wrong = missing if of_kind(kind) else column
        if len(wrong):
            raise DatasetError(
                f"{name}={wrong[0].as_py()!r}: every row needs {TYPES[name].__name__}"
            )
        columns[name] = column
    info = columns.pop("info")
    if not types.is_dictionary(info.type):
        info = info.dictionary_encode()
    info = info.unify_dictionaries()
    texts = info.chunk(0).dictionary.to_pylist() if info.num_chunks else []
    numbers = [chunk.indices.to_numpy() for chunk in info.chunks]
    pngs = None
    if pictures:
        found = [None] * len(table)
        if "obs" in table.column_names:
            found = pc.struct_field(table["obs"], "bytes").cast("binary").to_pylist()
        pngs = np.empty(len(table), object)
        pngs[:] = found
    return Rows(
        columns["actions"].to_numpy().astype(np.int64),
        columns["rewards"].to_numpy().astype(np.float32),
        columns["episode_starts"].to_numpy(),
        np.concatenate([np.zeros(0, np.int64), *numbers]).astype(np.int64),
        texts,
        pngs,
    )


def numbered(blocks: Iterable[Rows]) -> Iterator[tuple[Rows, NDArray[np.int64]]]:
    """Yield blocks of rows with the number of the labyrinth in each row, from 0, shape (n,)."""
    before, last = -1, ""
    for rows in blocks:
        if not len(rows.info):
            continue
        bare = [without_agent(text) for text in rows.texts]
        places = {text: place for place, text in enumerate(dict.fromkeys(bare))}
        labyrinth = np.array([places[text] for text in bare])[rows.info]
        begins = np.diff(labyrinth, prepend=places.get(last, -1)) != 0
        number = before + np.cumsum(begins)
        yield rows, number
        before, last = int(number[-1]), bare[rows.info[-1]]


class WholeEpisodes(NamedTuple):
    """The rows of one or more episodes, e of them."""

    rows: Rows
    firsts: NDArray[np.int64]
    """The first row of each episode, shape (e,)."""
    lasts: NDArray[np.int64]
    """The last row of each, which takes no action, shape (e,)."""

    def each(self) -> Iterator[tuple[str, list[int], float]]:
        """Yield the text, the actions and the return of each episode."""
        for first, last in zip(self.firsts.tolist(), self.lasts.tolist(), strict=True):
            text = self.rows.texts[self.rows.info[first]]
            rewards = self.rows.rewards[first:last].tolist()
            yield text, self.rows.actions[first:last].tolist(), sum(rewards)

    def take(self, episodes: slice | NDArray[np.bool_]) -> WholeEpisodes:
        """Return some of the episodes."""
        chosen = np.zeros(len(self.firsts), np.bool_)
        chosen[episodes] = True
        lengths = self.lasts - self.firsts + 1
        rows = self.rows.take(np.repeat(chosen, lengths))
        ends = np.cumsum(lengths[chosen])
        return WholeEpisodes(rows, ends - lengths[chosen], ends - 1)


def grouped(blocks: Iterable[Rows]) -> Iterator[WholeEpisodes]:
    """Yield the episodes of rows, which may cross the ends of blocks.

    Raises:
        DatasetError: The rows do not make episodes; raised after the episodes before that row.
    """
    pending: Rows | None = None
    before = 0
    for block in blocks:
        rows = block if pending is None else joined([pending, block])
        ends = np.flatnonzero(rows.actions == NO_ACTION)
        problem = _problem(rows, ends, before)
        if problem is not None:
            ends = ends[ends < problem[0]]
        whole = int(ends[-1]) + 1 if len(ends) else 0
        if whole:
            yield WholeEpisodes(rows.take(slice(whole)), np.append(0, ends[:-1] + 1), ends)
        if problem is not None:
            raise DatasetError(problem[1])
        before += whole
        pending = rows.take(slice(whole, None)) if whole < len(rows.actions) else None
    if pending is not None:
        raise DatasetError("the last episode ends without its last row, actions=-1")


def _problem(rows: Rows, ends: NDArray[np.int64], before: int) -> tuple[int, str] | None:
    """Return the first row that makes no episode with the others, and why, None if all do.

    Args:
        rows: The rows, of which the first has to begin an episode.
        ends: Those that take no action.
        before: How many rows there are before these.
    """
    begins = np.zeros(len(rows.actions), np.bool_)
    begins[:1] = True
    begins[ends[ends < len(begins) - 1] + 1] = True
    starts, other = rows.episode_starts, np.diff(rows.info, prepend=rows.info[:1]) != 0
    wrong = np.where(begins, ~starts | (rows.actions == NO_ACTION), starts | other)
    if not wrong.any():
        return None
    row = int(wrong.argmax())
    reason = ": an episode ends without its last row, actions=-1"
    if begins[row]:
        reason = " actions: -1 in the first row of an episode"
        if not starts[row]:
            reason = " episode_starts: False where an episode must begin"
    return row, f"row {before + row}{reason}"

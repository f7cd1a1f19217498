"""Open and check shards, and read their rows as arrays, grouped into whole episodes."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager
from functools import partial
from itertools import chain, islice
from math import fsum
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.data.format import (
    BATCH_ROWS,
    COLUMNS,
    NO_ACTION,
    OTHERS,
    Columns,
    values_of,
)
from labyrinth_core.data.manifest import (
    AGAIN,
    MOST_TEXTS,
    Shard,
    mended,
    readable,
    unless_replaced,
)
from labyrinth_core.errors import DatasetError, one_line
from labyrinth_core.remote import RemotePath
from labyrinth_core.storage import AnyPath, File

if TYPE_CHECKING:
    import pyarrow as pa
    import pyarrow.parquet
    from pyarrow.parquet import ParquetFile

_KINDS = {"i": int, "f": float, "b": bool}

TYPES = {each.name: _KINDS[each.dtype.kind] for each in COLUMNS.numbers} | {"info": str}
"""Column -> type of its values; pictures are left out."""

TOGETHER = 64
"""Row groups read together when pictures are not: parsing many texts at once is faster. Fewer if
their texts exceed `MOST_TEXTS`."""


Batch = TypeVar("Batch")


class Rows(NamedTuple):
    """Consecutive rows of a dataset, n of them."""

    actions: NDArray[np.int64]
    rewards: NDArray[np.float32]
    episode_starts: NDArray[np.bool_]
    info: NDArray[np.int64]
    """The index in `texts` of each row's text, shape (n,)."""
    texts: list[str]
    """Distinct texts, in the order of their first rows; some may be unused."""
    pngs: NDArray[np.object_] | None
    """The picture of each row, bytes or None, shape (n,); None if no pictures were read."""
    others: Mapping[str, NDArray[Any]]
    """The columns of `format.OTHERS` by name, shape (n,) each."""

    def take(self, rows: slice | NDArray[Any]) -> Rows:
        """Return some of the rows."""
        pngs = None if self.pngs is None else self.pngs[rows]
        columns = self.actions[rows], self.rewards[rows], self.episode_starts[rows]
        others = {name: values[rows] for name, values in self.others.items()}
        return Rows(*columns, self.info[rows], self.texts, pngs, others)


def joined(blocks: Sequence[Rows]) -> Rows:
    """Return consecutive rows as one block, with the texts that they use."""
    if len(blocks) == 1:
        return blocks[0]
    texts: dict[str, int] = {}
    info = []
    for block in blocks:
        used, which = np.unique(block.info, return_inverse=True)
        own = [block.texts[number] for number in used.tolist()]
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
        {each.name: np.concatenate([b.others[each.name] for b in blocks]) for each in OTHERS},
    )


def group_ends(file: pyarrow.parquet.ParquetFile) -> NDArray[np.int64]:
    """Return the row of a shard at which each row group ends, exclusive."""
    groups = map(file.metadata.row_group, range(file.num_row_groups))
    return np.cumsum([group.num_rows for group in groups])


def rows_together(
    file: pyarrow.parquet.ParquetFile, groups: Sequence[int], name: object, *, pictures: bool
) -> Iterator[Rows]:
    """Yield the rows of row groups; without pictures, `TOGETHER` groups are read at once.

    Args:
        file: The open shard.
        groups: The numbers of the row groups.
        name: What to name in the message of a DatasetError.
        pictures: Whether to read the pictures.
    """
    together = 1 if pictures else TOGETHER
    columns = [*TYPES, "obs.bytes"] if pictures else [*TYPES]
    batches = chain.from_iterable(
        _batches_of(file, groups[first : first + together], columns, name)
        for first in range(0, len(groups), together)
    )
    blocks = map(partial(rows_of_batch, name=name, pictures=pictures), batches)
    while some := list(_some_of(blocks, together)):
        yield joined(some)


def _batches_of(
    file: pyarrow.parquet.ParquetFile, groups: Sequence[int], columns: list[str], name: object
) -> Iterator[pa.RecordBatch]:
    """Yield the rows of row groups; raise DatasetError if Arrow loses some in a damaged page."""
    rows = sum(file.metadata.row_group(group).num_rows for group in groups)
    count = 0
    for batch in each_read(file.iter_batches(BATCH_ROWS, groups, columns), name):
        count += batch.num_rows
        yield batch
    if count != rows:
        raise DatasetError(f"{name} is damaged: it has {count} rows where there should be {rows}")


def each_read(batches: Iterator[Batch], name: object) -> Iterator[Batch]:
    """Yield what Arrow reads; an error in reading it becomes a DatasetError that names `name`."""
    while True:
        with readable(name):
            batch = list(islice(batches, 1))
        if not batch:
            return
        yield batch.pop()  # No variable holds the batch, so it is freed before the next is read.


def _some_of(blocks: Iterable[Rows], most: int) -> Iterator[Rows]:
    """Yield at most `most` blocks, and none after those whose texts exceed `MOST_TEXTS`."""
    size = 0
    for block in islice(blocks, most):
        yield block
        size += sum(map(len, block.texts))
        if size > MOST_TEXTS:
            return


@contextmanager
def opened(folder: AnyPath, shard: Shard) -> Iterator[pyarrow.parquet.ParquetFile]:
    """Check and open a shard.

    Raises:
        DatasetError: The shard is missing or damaged, or was replaced after its manifest was read.
    """
    path = folder / shard.path
    with unless_replaced(folder, shard), ExitStack() as stack:
        with readable(path):
            local = stack.enter_context(File(path).local_copy())
        before = mended(path, partial(_checked, local, shard, path))
        with readable(path):
            file = stack.enter_context(COLUMNS.opened(local))
            after = _identity(local)
        if after != before:
            raise DatasetError(f"{path} has changed while it was opened: run this again")
        check_footer(file, shard, path)
        yield file


def _checked(file: Path, shard: Shard, path: AnyPath) -> tuple[int, int, int]:
    """Return the identity of a file after comparing its size and hash with those of a shard."""
    with readable(path):
        identity = _identity(file)
    _check_size(identity[1], shard, path)
    check_file(file, shard, path)
    return identity


def _identity(path: Path) -> tuple[int, int, int]:
    """Return what changes if another file is put in the place of a file."""
    status = path.stat()
    return status.st_ino, status.st_size, status.st_mtime_ns


@contextmanager
def opened_in_place(path: RemotePath, shard: Shard) -> Iterator[pyarrow.parquet.ParquetFile]:
    """Open a remote shard: check its footer, and download only the byte ranges that are read."""
    with ExitStack() as stack:
        with readable(path):
            ranges = stack.enter_context(path.open_ranges())
            size = ranges.seek(0, os.SEEK_END)
        _check_size(size, shard, path)
        with readable(path):
            file = COLUMNS.opened(ranges, pre_buffer=True)
        check_footer(file, shard, path)
        yield file


def _check_size(size: int, shard: Shard, path: AnyPath) -> None:
    if size != shard.bytes:
        raise DatasetError(
            f"{path} is damaged: it has {size} bytes, and the manifest says {shard.bytes}; "
            f"delete it, and {AGAIN}"
        )


def check_footer(file: pyarrow.parquet.ParquetFile, shard: Shard, path: AnyPath) -> None:
    """Raise DatasetError if the footer of a file does not fit the shard."""
    problem = shard.footer_problem(file)
    if problem is not None:
        raise DatasetError(f"{path} is damaged: {problem}")


def check_file(file: AnyPath, shard: Shard, path: AnyPath) -> None:
    """Raise DatasetError if `file`, the shard at `path` or a copy of it, has the wrong SHA-256."""
    with readable(path):
        digest = File(file).sha256()
    if digest != shard.sha256:
        raise DatasetError(
            f"{path} is damaged: its sha256 is not the manifest's; delete it, and {AGAIN}"
        )


def rows_of_batch(batch: pa.RecordBatch, name: object, *, pictures: bool) -> Rows:
    """Return the rows of a batch of a shard; see `rows_of_table`."""
    import pyarrow as pa

    try:
        return rows_of_table(pa.Table.from_batches([batch]), pictures=pictures)
    except (pa.ArrowException, UnicodeDecodeError) as error:
        raise DatasetError(f"{name} cannot be read: {one_line(error)}") from error


def rows_of_table(table: pa.Table, *, pictures: bool) -> Rows:
    """Return the rows of a table; raise DatasetError for a missing value or a wrong type.

    A table without the column `obs` has no pictures.
    """
    import pyarrow as pa
    import pyarrow.compute as pc

    types = pa.types
    kinds_of = {int: types.is_integer, float: types.is_floating, bool: types.is_boolean}
    kinds = {each.name: kinds_of[TYPES[each.name]] for each in COLUMNS.numbers} | {
        "info": lambda each: types.is_string(each) or types.is_large_string(each)
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
    indices = [np.from_dlpack(chunk.indices) for chunk in info.chunks]
    pngs = None
    if pictures:
        pngs = np.empty(len(table), object)
        if "obs" in table.column_names:
            obs = pc.struct_field(table["obs"], "bytes").cast(
                pa.dictionary(pa.int32(), pa.binary())
            )
            pngs[:] = [value for chunk in obs.chunks for value in values_of(chunk)]
    return Rows(
        _numbers(columns["actions"]).astype(np.int64),
        _numbers(columns["rewards"]).astype(np.float32),
        _numbers(columns["episode_starts"]),
        np.concatenate([np.zeros(0, np.int64), *indices]).astype(np.int64),
        texts,
        pngs,
        {each.name: _numbers(columns[each.name]).astype(each.dtype) for each in OTHERS},
    )


def _numbers(column: pa.ChunkedArray) -> NDArray[Any]:
    """Return a column without nulls as an array, shape (rows,).

    `to_numpy` would import pandas if it is installed, which takes longer than reading a small
    dataset.
    """
    import pyarrow as pa

    if pa.types.is_dictionary(column.type):
        column = column.cast(column.type.value_type)
    if pa.types.is_boolean(column.type):
        return _numbers(column.cast(pa.uint8())).view(np.bool_)
    numbers: NDArray[Any] = np.from_dlpack(column.combine_chunks())
    return numbers


class WholeEpisodes(NamedTuple):
    """The rows of e whole episodes, e >= 1."""

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
            yield text, self.rows.actions[first:last].tolist(), fsum(rewards)

    def take(self, episodes: slice | NDArray[np.bool_]) -> WholeEpisodes:
        """Return some of the episodes."""
        chosen = np.zeros(len(self.firsts), np.bool_)
        chosen[episodes] = True
        lengths = self.lasts - self.firsts + 1
        rows = self.rows.take(np.repeat(chosen, lengths))
        ends = np.cumsum(lengths[chosen])
        return WholeEpisodes(rows, ends - lengths[chosen], ends - 1)


def grouped(blocks: Iterable[Rows]) -> Iterator[WholeEpisodes]:
    """Group blocks of rows into episodes, which may span several blocks.

    Raises:
        DatasetError: The rows do not form episodes; raised after the episodes before that row.
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
    """Return the first row that breaks an episode, and why; None if all rows form episodes.

    Args:
        rows: The rows; the first must begin an episode.
        ends: The indices of the rows without an action.
        before: The number of rows before these.
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


class ShardFile(NamedTuple):
    """A shard, and where its file is."""

    folder: AnyPath
    """The folder of the dataset, or of what was downloaded of it."""
    shard: Shard
    remote: RemotePath | None = None
    """The folder on the Hub to read the file in, if `folder` lacks it; None if it has the file."""

    @property
    def path(self) -> AnyPath:
        """The path of the file."""
        return (self.remote or self.folder) / self.shard.path

    def opened(self) -> AbstractContextManager[ParquetFile]:
        """Check and open the file; see `rows.opened`."""
        if self.remote is None or (self.folder / self.shard.path).is_file():
            return opened(self.folder, self.shard)
        return opened_in_place(self.remote / self.shard.path, self.shard)

    def rows(self, *, pictures: bool) -> Iterator[Rows]:
        """Yield the rows, some row groups at a time.

        Raises:
            DatasetError: The shard is missing, damaged, or not the one in the manifest.
        """
        with self.opened() as file:
            groups = range(file.num_row_groups)
            yield from rows_together(file, groups, self.path, pictures=pictures)

    def records(self, columns: Columns, rows: int) -> Iterator[dict[str, Any]]:
        """Yield the rows of a file with these columns as dictionaries, reading `rows` at a time.

        Raises:
            DatasetError: The file is missing, damaged, or has other columns.
        """
        import pyarrow as pa

        with self.opened() as file:
            # The types in the file: some columns are read as dictionaries.
            schema = file.schema.to_arrow_schema()
            if not schema.equals(columns.arrow_schema(), check_metadata=False):
                names = ", ".join(column.name for column in columns)
                raise DatasetError(f"{self.path}: its columns are not {names}")
            # Converted as they are read, since a text may not be UTF-8.
            batches = map(pa.RecordBatch.to_pylist, file.iter_batches(rows))
            yield from chain.from_iterable(each_read(batches, self.path))

    def episodes(self) -> Iterator[WholeEpisodes]:
        """Yield the episodes without pictures, some at a time; raise DatasetError as `rows`."""
        return grouped(self.rows(pictures=False))

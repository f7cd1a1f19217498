"""Open and check shards, and read their rows as arrays."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from itertools import chain, islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.data.errors import DatasetError, one_line
from labyrinth_core.data.format import GROUP_BYTES
from labyrinth_core.data.manifest import Shard
from labyrinth_core.data.storage import AnyPath, RemotePath, file_sha256, local_copy

if TYPE_CHECKING:
    import pyarrow as pa
    import pyarrow.parquet

BATCH_ROWS = 4096
"""The rows read at once; a hostile file may repeat a large picture in many rows."""

MOST_ROWS, MOST_BYTES = GROUP_BYTES // 512, 4 * GROUP_BYTES
"""The most rows and bytes of a row group; every picture has at least 512 bytes."""

TYPES = {"actions": int, "rewards": float, "episode_starts": bool, "info": str}
"""Column -> type of its values; pictures are left out."""

TOGETHER = 64
"""Row groups read together when pictures are not: parsing many texts at once is faster."""


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


def open_shard(path: Path) -> pyarrow.parquet.ParquetFile:
    """Open a Parquet file; `info` is read dictionary-encoded, as many rows share a text.

    Raises:
        OSError, ArrowException: The file cannot be read.
    """
    import pyarrow.parquet as pq

    with pq.ParquetFile(path) as file:
        names, footer = file.schema_arrow.names, file.metadata
    encoded = ["info"] if "info" in names else []
    return pq.ParquetFile(path, metadata=footer, read_dictionary=encoded)


def footer_problem(file: pyarrow.parquet.ParquetFile, rows: int) -> str | None:
    """Return why a footer cannot be that of a shard, before any row is read; None if it can.

    A few bytes may decompress to any number of rows, and a row group is read as a whole.

    Args:
        file: The file.
        rows: The number of rows in the manifest.
    """
    footer = file.metadata
    if footer.num_rows != rows:
        return f"rows {footer.num_rows}, but the manifest says {rows}"
    for group in map(footer.row_group, range(footer.num_row_groups)):
        if group.num_rows > MOST_ROWS:
            return f"a row group has {group.num_rows} rows, more than {MOST_ROWS}"
        if group.total_byte_size > MOST_BYTES:
            return f"a row group has {group.total_byte_size} bytes, more than {MOST_BYTES}"
    return None


def group_ends(file: pyarrow.parquet.ParquetFile) -> NDArray[np.int64]:
    """Return the row of a shard at which each row group ends, exclusive."""
    groups = map(file.metadata.row_group, range(file.num_row_groups))
    return np.cumsum([group.num_rows for group in groups])


def rows_together(
    file: pyarrow.parquet.ParquetFile, groups: Sequence[int], *, pictures: bool
) -> Iterator[Rows]:
    """Yield the rows of row groups; without pictures, `TOGETHER` groups are read at once."""
    import pyarrow as pa

    together = 1 if pictures else TOGETHER
    columns = [*TYPES, "obs.bytes"] if pictures else [*TYPES]
    batches = chain.from_iterable(
        file.iter_batches(BATCH_ROWS, groups[first : first + together], columns)
        for first in range(0, len(groups), together)
    )
    # `map` frees each batch before the next is read, which a loop variable would not.
    tables = map(pa.Table.from_batches, map(list, zip(batches, strict=True)))
    blocks = map(partial(rows_of_table, pictures=pictures), tables)
    while some := list(islice(blocks, together)):
        yield joined(some)


@contextmanager
def opened(folder: AnyPath, shard: Shard) -> Iterator[pyarrow.parquet.ParquetFile]:
    """Check and open a shard; a read error inside the block becomes a DatasetError."""
    path = folder / shard.path
    with readable(path), local_copy(path) as local:
        check_file(local, shard, path)
        with open_shard(local) as file:
            check_footer(file, shard, path)
            yield file


@contextmanager
def opened_in_place(path: RemotePath, shard: Shard) -> Iterator[pyarrow.parquet.ParquetFile]:
    """Open a remote shard: check its footer, and download only the byte ranges that are read.

    A read error inside the block becomes a DatasetError.
    """
    import pyarrow.parquet as pq

    with readable(path), path.open_ranges() as ranges:
        file = pq.ParquetFile(ranges, pre_buffer=True, read_dictionary=["info"])
        check_footer(file, shard, path)
        yield file


def check_footer(file: pyarrow.parquet.ParquetFile, shard: Shard, path: AnyPath) -> None:
    """Raise DatasetError if the footer of a file does not fit the shard."""
    problem = footer_problem(file, shard.rows)
    if problem is not None:
        raise DatasetError(f"{path} is damaged: {problem}")


def check_file(file: AnyPath, shard: Shard, path: AnyPath) -> None:
    """Raise DatasetError if `file`, the shard at `path` or a copy of it, has the wrong SHA-256."""
    if file_sha256(file) != shard.sha256:
        raise DatasetError(
            f"{path} is damaged: its sha256 is not the manifest's; "
            "delete it, and build or download it again"
        )


@contextmanager
def readable(place: object) -> Iterator[None]:
    """Turn a read error inside the block into a DatasetError that names `place`."""
    import pyarrow as pa

    try:
        yield
    except (MemoryError, GeneratorExit):
        # The files are fine. Arrow's MemoryError is an ArrowException, too; and when Python exits,
        # it closes unfinished streams (GeneratorExit) after Arrow's names are gone.
        raise
    except Exception as error:
        from huggingface_hub.errors import HTTPError  # type: ignore[attr-defined]

        if isinstance(error, (OSError, ValueError, LookupError, pa.ArrowException, HTTPError)):
            raise DatasetError(f"{place} cannot be read: {one_line(error)}") from error
        raise


def rows_of_table(table: pa.Table, *, pictures: bool) -> Rows:
    """Return the rows of a table; raise DatasetError for a missing value or a wrong type.

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

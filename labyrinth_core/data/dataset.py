"""Locate a dataset, a split or some of its labyrinths, and the row groups that hold them.

The table of labyrinths is the index: it gives the rows of each labyrinth.
"""

from __future__ import annotations

import hashlib
from collections.abc import Generator, Iterable, Iterator, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.data.dataset_config import DatasetConfig
from labyrinth_core.data.episodes import Episodes, WholeEpisodes, grouped, replayed
from labyrinth_core.data.format import GROUP_BYTES, Columns
from labyrinth_core.data.location import download, explained, local_folder
from labyrinth_core.data.manifest import Manifest, Shard, replaced
from labyrinth_core.data.rows import (
    Rows,
    each_read,
    group_ends,
    opened,
    opened_in_place,
    rows_together,
)
from labyrinth_core.data.selection import Filter as Filter
from labyrinth_core.data.selection import Spans, Step, ends_of, select
from labyrinth_core.data.table import table_file, table_groups
from labyrinth_core.errors import DatasetError
from labyrinth_core.remote import RemotePath
from labyrinth_core.storage import AnyPath

if TYPE_CHECKING:
    import pyarrow as pa
    from pyarrow.parquet import ParquetFile

FULL = GROUP_BYTES // 4
"""A row group of fewer bytes ends with an episode; see `GROUP_BYTES`."""

Marks = NDArray[np.int8]
"""Per row of a shard: 0 not requested, 1 requested, 2 requested and the first of its labyrinth."""


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


@dataclass(frozen=True, eq=False)
class Part:
    """The rows that a query requests."""

    query: Query
    files: Sequence[ShardFile]
    """All shards of the split."""
    spans: Spans | None = None
    """The requested labyrinths; None for all rows."""

    @property
    def shards(self) -> list[Shard]:
        """All shards of the split."""
        return [file.shard for file in self.files]

    @property
    def config(self) -> DatasetConfig:
        """The dataset's config, which `replayed` checks labyrinths against."""
        return self.query.dataset.manifest.config

    def __len__(self) -> int:
        """Return the number of rows."""
        return int(self.counts().sum())

    def counts(self) -> NDArray[np.int64]:
        """Return the number of rows of each shard that belong to this part."""
        if self.spans is None:
            return np.array([file.shard.rows for file in self.files])
        firsts, rows = self.spans
        counts = np.zeros(len(self.files), np.int64)
        np.add.at(counts, np.searchsorted(ends_of(self.shards), firsts, "right"), rows)
        return counts

    def key(self) -> list[str]:
        """Return the hash of each shard, and of the selection of rows unless all are selected."""
        hashes = [shard.sha256 for shard in self.shards]
        if self.spans is not None:
            firsts, rows = self.spans
            ends = firsts + rows
            apart = np.append(True, firsts[1:] != ends[:-1])  # From the labyrinth before.
            runs = np.stack([firsts[apart], ends[np.append(apart[1:], True)]])
            hashes.append(hashlib.sha256(runs.tobytes()).hexdigest())
        return hashes

    def require_sizes(self) -> None:
        """Raise DatasetError if a shard is not of the size in the manifest.

        Call it before memory is taken for the rows that the manifest promises.
        """
        for number in np.flatnonzero(self.counts()).tolist():
            folder, shard, _ = self.files[number]
            try:
                size = (folder / shard.path).stat().st_size
            except OSError:  # Reading the shard says why.
                continue
            if size != shard.bytes:
                with self.opened(number):  # It raises the error.
                    pass

    def _marks(self, spans: Spans, number: int) -> Marks:
        """Return the marks of the rows of a shard, which has as many as the manifest says."""
        count = self.files[number].shard.rows
        begin = int(ends_of(self.shards)[number]) - count
        own = slice(*np.searchsorted(spans[0], [begin, begin + count]))
        firsts, rows = spans[0][own] - begin, spans[1][own]
        steps = np.zeros(count + 1, np.int8)
        steps[firsts] += 1
        steps[firsts + rows] -= 1
        marks = np.cumsum(steps[:-1], dtype=np.int8)
        marks[firsts] = 2
        return marks

    def rows(self, *, pictures: bool) -> Iterator[Rows]:
        """Yield the rows; row groups that contain none of them are not read.

        Raises:
            DatasetError: A shard is missing, damaged, or not the one in the manifest.
        """
        for number in np.flatnonzero(self.counts()).tolist():
            with self.opened(number) as file:
                groups = range(file.num_row_groups)
                yield from self.rows_of(file, number, groups, pictures=pictures)

    def rows_of(
        self, file: ParquetFile, number: int, groups: Sequence[int], *, pictures: bool
    ) -> Iterator[Rows]:
        """Yield the rows in some row groups of shard `number`, which is open as `file`."""
        path = self.files[number].path
        if self.spans is None:
            yield from rows_together(file, groups, path, pictures=pictures)
            return
        marks = np.split(self._marks(self.spans, number), group_ends(file)[:-1])
        groups = [group for group in groups if marks[group].any()]
        first, kept = 0, np.concatenate([marks[group] for group in groups])
        for rows in rows_together(file, groups, path, pictures=pictures):
            end = first + len(rows.actions)
            yield rows.take(np.flatnonzero(kept[first:end]))
            first = end

    def replayed(self, *, pictures: bool) -> Generator[Episodes]:
        """Yield the episodes, replayed many at a time; see `episodes.replayed`."""
        return replayed(self.rows(pictures=pictures), self.config)

    def units(self, file: ParquetFile, number: int) -> tuple[list[range], NDArray[np.int64]]:
        """Divide a shard into units, the smallest runs of row groups that no episode crosses.

        Returns:
            The row groups of each unit, and the number of its rows that belong to this part.
        """
        ends = group_ends(file)
        sizes = [file.metadata.row_group(n).total_byte_size for n in range(len(ends) - 1)]
        whole, firsts = np.array(sizes) < FULL, ends[:-1]
        own = None if self.spans is None else self._marks(self.spans, number)
        if not whole.all():
            marks = self._marks(self._all, number) if own is None else own
            whole |= (marks[firsts] != 1) | (marks[firsts - 1] == 0)
        cuts = np.array([0, *(np.flatnonzero(whole) + 1), len(ends)])
        bounds = np.append(0, ends)[cuts]
        if own is not None:
            bounds = np.append(0, np.cumsum(own > 0))[bounds]
        return [*map(range, cuts[:-1], cuts[1:])], np.diff(bounds)

    @cached_property
    def _all(self) -> Spans:
        """All labyrinths of the split, from the table of labyrinths."""
        return replace(self.query, steps=()).spans

    def opened(self, number: int) -> AbstractContextManager[ParquetFile]:
        """Check and open a shard; see `rows.opened`."""
        return self.files[number].opened()


class Source:
    """A dataset in a folder or on the Hub, which is located when something of it is needed."""

    def __init__(self, source: str | Path, config: str, revision: str | None = None) -> None:
        self.source, self.config, self.revision = source, config, revision

    @cached_property
    def local(self) -> AnyPath | None:
        """The folder of the dataset, which may be remote; None for an id on the Hub."""
        return local_folder(self.source, self.config, self.revision)

    @cached_property
    def commit(self) -> str | None:
        """The commit on the Hub from which everything is read; None for a folder."""
        if self.local is not None:
            return None
        from labyrinth_core import hub

        with explained(str(self.source), self.revision):
            return hub.commit_of(str(self.source), "dataset", self.revision)

    def locate(self, files: Iterable[str]) -> AnyPath:
        """Return the folder with the manifest and the files that match names or patterns.

        Files on the Hub are downloaded first; `../README.md` is the dataset card of all configs.

        Raises:
            DatasetError: The folder does not exist, or the Hub cannot provide it.
        """
        if self.commit is None:
            assert self.local is not None
            return self.local
        return download(str(self.source), self.config, [*files], self.commit)

    @cached_property
    def manifest(self) -> Manifest:
        """The manifest, which is read once."""
        return Manifest.read(self.locate([]))

    def files(self, split: str | None = None) -> list[ShardFile]:
        """Return the shards of a split, or of all, in order; on the Hub they are downloaded."""
        shards = self.manifest.shards if split is None else self.manifest.of(split)
        folder = self.locate([shard.path for shard in shards])
        return [ShardFile(folder, shard) for shard in shards]

    def table_groups(self, columns: Sequence[str] | None = None) -> Iterator[pa.Table]:
        """Yield the row groups of the table of labyrinths; see `manifest.table_groups`."""
        return table_groups(self.locate([Manifest.TABLE]), self.manifest, columns)

    def check_table(self) -> None:
        """Raise DatasetError if the table of labyrinths is missing or damaged."""
        with table_file(self.locate([Manifest.TABLE]), self.manifest):
            pass  # Opening it checks it.

    def require_unchanged(self) -> None:
        """Raise DatasetError if the dataset in a folder was replaced since its manifest was read.

        A job that reads several splits calls this after it has opened the last. What is read from
        the Hub is of one commit, which does not change.
        """
        folder = self.local
        if folder is None or not (folder / Manifest.FILE).is_file():
            return
        if Manifest.read(folder).fingerprint != self.manifest.fingerprint:
            raise replaced(folder)


@dataclass(frozen=True, eq=False)
class Query:
    """A request for a split, or for some labyrinths of it."""

    dataset: Source
    split: str
    steps: tuple[Step, ...] = ()
    """How labyrinths are chosen, one step after the other; none for the whole split."""

    def filter(self, where: Filter | None = None, *, labyrinths: int | None = None) -> Self:
        """Return a request for some of these labyrinths; see `load.load_episodes`."""
        if where is None and labyrinths is None:
            return self
        return replace(self, steps=(*self.steps, Step(where, labyrinths)))

    @cached_property
    def spans(self) -> Spans:
        """The rows of the requested labyrinths; see `select`."""
        return select(
            self.dataset.locate([Manifest.TABLE]), self.dataset.manifest, self.split, self.steps
        )

    def part(self, *, in_place: bool = False) -> Part:
        """Return the split or part; only the shards that it needs are downloaded from the Hub.

        Args:
            in_place: Whether to read shards on the Hub remotely instead of downloading them.

        Raises:
            ValueError, DatasetError: As for `load.load_episodes`.
        """
        dataset, remote = self.dataset, None
        folder = dataset.locate([] if self.steps or in_place else [f"{self.split}-*.parquet"])
        shards = dataset.manifest.of(self.split)
        part = Part(self, [ShardFile(folder, shard) for shard in shards])
        if self.steps:
            if self.spans[1].sum() < len(part):
                part = replace(part, spans=self.spans)
            if not in_place:
                held = zip(shards, part.counts(), strict=True)
                folder = dataset.locate([shard.path for shard, rows in held if rows])
        if in_place and dataset.commit is not None:
            remote = RemotePath(f"hf://datasets/{dataset.source}@{dataset.commit}/{dataset.config}")
        return replace(part, files=[ShardFile(folder, shard, remote) for shard in shards])

"""Locate a dataset, a split or some of its labyrinths, and the row groups that hold them.

The table of labyrinths is the index: it gives the rows of each labyrinth.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterable, Iterator, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from posixpath import normpath
from typing import TYPE_CHECKING, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.data.dataset_config import CONFIG_NAME, DatasetConfig
from labyrinth_core.data.episodes import WholeEpisodes, grouped
from labyrinth_core.data.errors import DatasetError, one_line
from labyrinth_core.data.format import GROUP_BYTES
from labyrinth_core.data.manifest import (
    MANIFEST,
    TABLE,
    Manifest,
    Shard,
    replaced,
    table_file,
    table_groups,
)
from labyrinth_core.data.rows import Rows, group_ends, opened, opened_in_place, rows_together
from labyrinth_core.data.selection import Filter as Filter
from labyrinth_core.data.selection import Spans, Step, ends_of, select
from labyrinth_core.data.storage import AnyPath, RemotePath, folder_at

if TYPE_CHECKING:
    import pyarrow as pa
    from pyarrow.parquet import ParquetFile

HUB_ID = re.compile(r"(?!.*(--|\.\.))\w[\w.-]*/\w[\w.-]*", re.ASCII)

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
        """Raise DatasetError if a local shard is not of the size in the manifest.

        Call it before memory is taken for the rows that the manifest promises.
        """
        for number in np.flatnonzero(self.counts()).tolist():
            folder, shard, _ = self.files[number]
            path, size = folder / shard.path, shard.bytes
            if isinstance(path, Path) and path.is_file() and path.stat().st_size != size:
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
        self._commit = revision
        self._snapshot: Path | None = None

    @cached_property
    def local(self) -> AnyPath | None:
        """The folder of the dataset, which may be remote; None for an id on the Hub."""
        return local_folder(self.source, self.config, self.revision)

    def locate(self, files: Iterable[str]) -> AnyPath:
        """Return the folder with the manifest and the files that match names or patterns.

        Files on the Hub are downloaded first; `../README.md` is the dataset card of all configs.

        Raises:
            DatasetError: The folder does not exist, or the Hub cannot provide it.
        """
        if self.local is not None:
            return self.local
        self._snapshot = _download(str(self.source), self.config, files, self._commit)
        return self._snapshot

    @cached_property
    def manifest(self) -> Manifest:
        """The manifest, which is read once."""
        return Manifest.read(self._snapshot or self.locate([]))

    def files(self, split: str | None = None) -> list[ShardFile]:
        """Return the shards of a split, or of all, in order; on the Hub they are downloaded."""
        shards = self.manifest.shards if split is None else self.manifest.of(split)
        folder = self.locate([shard.path for shard in shards])
        return [ShardFile(folder, shard) for shard in shards]

    def table_groups(self, columns: Sequence[str] | None = None) -> Iterator[pa.Table]:
        """Yield the row groups of the table of labyrinths; see `manifest.table_groups`."""
        return table_groups(self.locate([TABLE]), self.manifest, columns)

    def check_table(self) -> None:
        """Raise DatasetError if the table of labyrinths is missing or damaged."""
        with table_file(self.locate([TABLE]), self.manifest):
            pass  # Opening it checks it.

    def pin(self) -> str:
        """Return the commit on the Hub that was read last, from which all else is read, too."""
        assert self._snapshot is not None
        self._commit = self._snapshot.parent.name
        return self._commit

    def require_unchanged(self) -> None:
        """Raise DatasetError if the dataset in a folder was replaced since its manifest was read.

        A job that reads several splits calls this after it has opened the last. What is read from
        the Hub is of one commit, which does not change.
        """
        folder = self.local
        if folder is None or not (folder / MANIFEST).is_file():
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
        return select(self.dataset.locate([TABLE]), self.dataset.manifest, self.split, self.steps)

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
        if in_place and dataset.local is None:
            remote = RemotePath(f"hf://datasets/{dataset.source}@{dataset.pin()}/{dataset.config}")
        return replace(part, files=[ShardFile(folder, shard, remote) for shard in shards])


def local_folder(source: str | Path, config: str, revision: str | None) -> AnyPath | None:
    """Return the folder with a dataset's manifest, or None for an id on the Hub.

    Raises:
        ValueError: A revision is given for a folder, or `source` or `config` has the wrong type.
        DatasetError: The source is neither a folder nor an id, or has no such config.
    """
    if not isinstance(config, str):
        raise ValueError(f"config={config!r}: give a name, such as '5x5'")
    try:
        folder = folder_at(source)
    except TypeError as error:
        told = "give a folder, or an id such as user/labyrinth"
        raise ValueError(f"source={source!r:.60}: {told}") from error
    except ValueError as error:
        raise DatasetError(str(error)) from error
    if folder.is_dir():
        if revision is not None:
            raise ValueError(f"revision={revision}: {source} is a folder, which has no revisions")
        if not _has_episodes(folder / config):
            if (folder / MANIFEST).is_file():
                raise DatasetError(
                    f"{source} is the folder of the config {folder.name}: give the folder that "
                    f"holds it, {folder.parent}"
                )
            raise _no_config(source, config, map(str, folder.glob(f"*/{MANIFEST}")))
        return folder / config
    if not HUB_ID.fullmatch(str(source)):
        raise DatasetError(f"{source} is neither a folder nor an id such as user/labyrinth")
    return None


def _download(source: str, config: str, files: Iterable[str], revision: str | None) -> Path:
    from huggingface_hub import HfApi, snapshot_download
    from huggingface_hub.errors import RevisionNotFoundError

    from labyrinth_core.data.hub import UNAVAILABLE, prepare_client

    prepare_client()
    patterns = [normpath(f"{config}/{name}") for name in (MANIFEST, *files)]
    try:
        snapshot = snapshot_download(
            source, repo_type="dataset", revision=revision, allow_patterns=patterns
        )
        if _has_episodes(Path(snapshot, config)):
            return Path(snapshot) / config
        there = HfApi().list_repo_files(source, repo_type="dataset", revision=revision)
    except RevisionNotFoundError as error:
        raise DatasetError(_no_revision(source, revision)) from error
    except UNAVAILABLE as error:
        raise DatasetError(f"{why_unavailable(source, error)}: {one_line(error)}") from error
    manifests = (path for path in there if re.fullmatch(rf"[^/]+/{MANIFEST}", path))
    raise _no_config(source, config, manifests)


def _no_revision(source: str, revision: str | None) -> str:
    """Return a message for a revision that a dataset on the Hub lacks, with those that it has."""
    from huggingface_hub import HfApi

    from labyrinth_core.data.hub import UNAVAILABLE

    message = f"{source} has no revision {revision}"
    try:
        refs = HfApi().list_repo_refs(source, repo_type="dataset")
    except UNAVAILABLE:
        return message
    return f"{message}, it has {', '.join(ref.name for ref in (*refs.tags, *refs.branches))}"


def why_unavailable(source: str, error: Exception) -> str:
    """Explain an error with which the Hub's client or `datasets` failed to provide a dataset."""
    file = error.filename if isinstance(error, OSError) else None
    if file is not None and not Path(file).resolve().is_relative_to(Path(source).resolve()):
        return f"{source}: the cache of the Hub's client cannot be used (HF_HOME moves it)"
    if Path(source).is_dir():
        return f"{source} cannot be read"
    return f"{source} is neither a folder (labyrinth-datasets makes one) nor available on the Hub"


def _has_episodes(folder: AnyPath) -> bool:
    return (folder / MANIFEST).is_file() and CONFIG_NAME.fullmatch(folder.name) is not None


def _no_config(source: str | Path, config: str, manifests: Iterable[str]) -> DatasetError:
    names = (path.split("/")[-2] for path in manifests)
    held = sorted(filter(CONFIG_NAME.fullmatch, names))
    none = f"no dataset: it has no {MANIFEST}, which `push_to_hub` of `datasets` leaves out"
    return DatasetError(f"config={config}: {source} holds {', '.join(held) or none}")

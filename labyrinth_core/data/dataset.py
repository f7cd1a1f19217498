"""Find a dataset in a folder or on the Hub, a split or some of its labyrinths, and their rows.

The table of labyrinths is the index: it gives the rows of each labyrinth.
"""

from __future__ import annotations

import fnmatch
import hashlib
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain
from pathlib import Path
from posixpath import normpath
from typing import TYPE_CHECKING, Self

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.data.dataset_config import DatasetConfig
from labyrinth_core.data.format import GROUP_BYTES
from labyrinth_core.data.manifest import Manifest, Shard, readable, replaced
from labyrinth_core.data.rows import (
    Rows,
    ShardFile,
    group_ends,
    rows_together,
)
from labyrinth_core.data.table import Filter as Filter
from labyrinth_core.data.table import LabyrinthTable, Spans, Step, ends_of
from labyrinth_core.errors import DatasetError
from labyrinth_core.remote import RemotePath
from labyrinth_core.storage import AnyPath, folder_at

if TYPE_CHECKING:
    import pyarrow as pa
    from pyarrow.parquet import ParquetFile

FULL = GROUP_BYTES // 4
"""A row group of fewer bytes ends with an episode; see `GROUP_BYTES`."""

Marks = NDArray[np.int8]
"""Per row of a shard: 0 not requested, 1 requested, 2 requested and the first of its labyrinth."""


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
                with self.files[number].opened():  # It raises the error.
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
            with self.files[number].opened() as file:
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

    @property
    def labyrinth_table(self) -> LabyrinthTable:
        """The table of labyrinths, which is downloaded first if it is on the Hub."""
        return LabyrinthTable(self.locate([Manifest.TABLE]), self.manifest)

    def table_groups(self, columns: Sequence[str] | None = None) -> Iterator[pa.Table]:
        """Yield the row groups of the table of labyrinths; see `LabyrinthTable.groups`."""
        return self.labyrinth_table.groups(columns)

    def check_table(self) -> None:
        """Raise DatasetError if the table of labyrinths is missing or damaged."""
        with self.labyrinth_table.opened():
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
        """The rows of the requested labyrinths; see `LabyrinthTable.select`."""
        return self.dataset.labyrinth_table.select(self.split, self.steps)

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


def local_folder(source: str | Path, config: str, revision: str | None) -> AnyPath | None:
    """Return the folder with a dataset's manifest, or None for an id on the Hub.

    Raises:
        ValueError: A revision is given for a folder, or `source` or `config` has the wrong type.
        DatasetError: The source is neither a folder nor an id, or has no such config.
    """
    if not isinstance(config, str):
        raise ValueError(f"config={config!r}: give a name, such as '5x5'")
    folder = folder_of(source)
    if folder is None:
        return None
    if revision is not None:
        raise ValueError(f"revision={revision}: {source} is a folder, which has no revisions")
    with readable(source):
        has_episodes = _has_episodes(folder / config)
        is_inside = not has_episodes and (folder / Manifest.FILE).is_file()
        held = [] if has_episodes else [*map(str, folder.glob(f"*/{Manifest.FILE}"))]
    if is_inside:
        raise DatasetError(
            f"{source} is the folder of the config {folder.name}: give the folder that "
            f"holds it, {folder.parent}"
        )
    if not has_episodes:
        raise _no_config(source, config, held)
    return folder / config


def folder_of(source: str | Path) -> AnyPath | None:
    """Return the folder that a source of datasets names, or None for an id on the Hub.

    Raises:
        ValueError: The source has the wrong type.
        DatasetError: It is neither a folder nor an id.
    """
    try:
        folder = folder_at(source)
    except TypeError as error:
        allowed = "give a folder, or an id such as user/labyrinth"
        raise ValueError(f"source={source!r:.60}: {allowed}") from error
    except ValueError as error:
        raise DatasetError(str(error)) from error
    with readable(source):
        if folder.is_dir():
            return folder
    from labyrinth_core import hub

    if not hub.ID.fullmatch(str(source)):
        raise DatasetError(f"{source} is neither a folder nor an id such as user/labyrinth")
    return None


@contextmanager
def explained(source: str, revision: str | None) -> Iterator[None]:
    """Turn the errors of the Hub's client into a DatasetError, one line."""
    from huggingface_hub.errors import RevisionNotFoundError

    from labyrinth_core import hub

    try:
        yield
    except DatasetError:
        raise
    except RevisionNotFoundError as error:
        raise DatasetError(_no_revision(source, revision)) from error
    except hub.UNAVAILABLE as error:
        raise DatasetError(
            f"{hub.why_unavailable(source, error)}: {hub.reason_of(error)}"
        ) from error


def download(source: str, config: str, files: Sequence[str], commit: str) -> Path:
    """Download a dataset's manifest and the files that match; return the folder of the config.

    Raises:
        DatasetError: The Hub cannot provide them, or has no such config.
    """
    from huggingface_hub import HfApi

    from labyrinth_core import hub

    def downloaded(names: Iterable[str]) -> Path:
        paths = [normpath(f"{config}/{name}") for name in names]
        return hub.download(source, "dataset", commit, paths) / config

    with explained(source, commit):
        folder = downloaded([Manifest.FILE])
        if not _has_episodes(folder):
            names_on_hub = hub.repeated(
                lambda: HfApi().list_repo_files(source, repo_type="dataset", revision=commit)
            )
            if f"{config}/{Manifest.FILE}" in names_on_hub:
                raise DatasetError(
                    f"{source}: the Hub lists {config}/{Manifest.FILE} but has it not"
                )
            raise _no_config(
                source, config, (path for path in names_on_hub if path.count("/") == 1)
            )
        hub.require_whole(folder / Manifest.FILE)
    if files:
        shards = [shard.path for shard in Manifest.read(folder).shards]
        named = (
            fnmatch.filter(shards, pattern) if "*" in pattern else [pattern] for pattern in files
        )
        with explained(source, commit):
            downloaded([*chain.from_iterable(named)])
    return folder


def _no_revision(source: str, revision: str | None) -> str:
    """Return a message for a revision that a dataset on the Hub lacks, with those that it has."""
    from huggingface_hub import HfApi

    from labyrinth_core import hub

    message = f"{source} has no revision {revision}"
    try:
        refs = hub.repeated(lambda: HfApi().list_repo_refs(source, repo_type="dataset"))
    except hub.UNAVAILABLE:
        return message
    return f"{message}, it has {', '.join(ref.name for ref in (*refs.tags, *refs.branches))}"


def _has_episodes(folder: AnyPath) -> bool:
    return (folder / Manifest.FILE).is_file() and DatasetConfig.NAME.fullmatch(
        folder.name
    ) is not None


def _no_config(source: str | Path, config: str, manifests: Iterable[str]) -> DatasetError:
    names = (path.split("/")[-2] for path in manifests if path.endswith(f"/{Manifest.FILE}"))
    held = sorted(filter(DatasetConfig.NAME.fullmatch, names))
    none = f"no dataset: it has no {Manifest.FILE}, which `push_to_hub` of `datasets` leaves out"
    return DatasetError(f"config={config}: {source} holds {', '.join(held) or none}")

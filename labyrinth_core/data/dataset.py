"""Find a dataset: its folder, a split or some labyrinths of it, and the row groups with them.

The table of labyrinths is the index: it says which rows a labyrinth has.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from posixpath import normpath
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.data.dataset_config import QUESTIONS, DatasetConfig
from labyrinth_core.data.errors import DatasetError, one_line
from labyrinth_core.data.format import GROUP_BYTES, TABLE_COLUMNS
from labyrinth_core.data.manifest import MANIFEST, TABLE, Manifest, Shard, table_file
from labyrinth_core.data.rows import Rows, opened, opened_in_place, rows_together
from labyrinth_core.data.storage import AnyPath, RemotePath, folder_at
from labyrinth_core.world.grid import whole

if TYPE_CHECKING:
    from pyarrow.compute import Expression
    from pyarrow.parquet import ParquetFile

HUB_ID = re.compile(r"(?!.*(--|\.\.))\w[\w.-]*/\w[\w.-]*", re.ASCII)

FULL = GROUP_BYTES // 4
"""A row group of fewer bytes ends with an episode; see `GROUP_BYTES`."""

Filter: TypeAlias = "Expression"
"""A filter of the table of labyrinths, such as `pyarrow.compute.field("moves") >= 12`."""


@dataclass(frozen=True, eq=False)
class Part:
    """A split, or some labyrinths of it."""

    folder: AnyPath
    shards: Sequence[Shard]
    """All shards of the split."""
    kept: NDArray[np.bool_] | None = None
    """Which of the split's first rows are those of the labyrinths, shape (n,); None for all."""
    place: RemotePath | None = None
    """Where the shards are that the folder does not hold; None if it holds all that are needed."""
    config: DatasetConfig | None = None
    """The dataset, if it is known; see `replayed`."""
    whole: Wanted | None = None
    """The whole split, whose table `units` may need."""

    def __len__(self) -> int:
        """Return the number of its rows."""
        return int(self.kept_before(self.first_rows())[-1])

    def held(self) -> list[int]:
        """Return the numbers of the shards that hold some of its rows."""
        if self.kept is None:
            return [*range(len(self.shards))]
        kept: list[int] = np.flatnonzero(np.diff(self.kept_before(self.first_rows()))).tolist()
        return kept

    def rows(self, *, pictures: bool) -> Iterator[Rows]:
        """Yield its rows; no row group is read that holds none of them.

        Raises:
            DatasetError: A shard is missing or damaged, or not the one that the manifest describes.
        """
        for number in self.held():
            with self.opened(number) as file:
                groups = range(file.num_row_groups)
                yield from self.rows_of(file, number, groups, pictures=pictures)

    def rows_of(
        self, file: ParquetFile, number: int, groups: Sequence[int], *, pictures: bool
    ) -> Iterator[Rows]:
        """Yield its rows in row groups of a shard, given the opened file and the shard's number."""
        ends = self.group_rows(file, number)
        counts = np.diff(self.kept_before(ends))
        groups = [group for group in groups if counts[group]]
        blocks = rows_together(file, groups, pictures=pictures)
        if self.kept is None or not groups:
            yield from blocks
            return
        first, kept = 0, np.concatenate([self.kept[ends[n] : ends[n + 1]] for n in groups])
        for rows in blocks:
            end = first + len(rows.actions)
            yield rows.take(np.flatnonzero(kept[first:end]))
            first = end

    def units(self, file: ParquetFile, number: int) -> tuple[list[range], NDArray[np.int64]]:
        """Divide a shard into units, each of the fewest row groups that no episode leaves.

        Returns:
            The row groups of each unit, and how many of its rows are kept.
        """
        ends = self.group_rows(file, number)
        sizes = [file.metadata.row_group(n).total_byte_size for n in range(len(ends) - 2)]
        end_episodes = np.array(sizes) < FULL
        if not end_episodes.all():
            end_episodes |= self._begins[ends[1:-1]]
        cuts = np.array([0, *(np.flatnonzero(end_episodes) + 1), len(ends) - 1])
        return [*map(range, cuts[:-1], cuts[1:])], np.diff(self.kept_before(ends[cuts]))

    @cached_property
    def _begins(self) -> NDArray[np.bool_]:
        """Whether each row of the split is the first of a labyrinth, from the table."""
        assert self.whole is not None
        begins = np.zeros(self.first_rows()[-1], np.bool_)
        manifest = Manifest.read(self.whole.locate([]))
        begins[_row_ranges(self.whole, manifest)[:, 0]] = True
        return begins

    def opened(self, number: int) -> AbstractContextManager[ParquetFile]:
        """Open a shard; an error within means that it cannot be read."""
        shard = self.shards[number]
        if self.place is None or (self.folder / shard.path).is_file():
            return opened(self.folder, shard)
        return opened_in_place(self.place / shard.path, shard)

    def first_rows(self) -> NDArray[np.int64]:
        """Return the number in the split of each shard's first row, and of the last one's end."""
        return np.cumsum([0, *(shard.rows for shard in self.shards)])

    def group_rows(self, file: ParquetFile, number: int) -> NDArray[np.int64]:
        """Return the number in the split of each row group's first row, and of the last's end."""
        groups = map(file.metadata.row_group, range(file.num_row_groups))
        return np.cumsum([self.first_rows()[number], *(group.num_rows for group in groups)])

    def kept_before(self, rows: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return how many rows before each of some are kept."""
        if self.kept is None:
            return rows
        count = np.append(0, np.cumsum(self.kept))
        return count[np.minimum(rows, len(self.kept))]


@dataclass(frozen=True)
class Wanted:
    """A split or a part of it that a caller wants; see `load.load_episodes` for the fields."""

    source: str | Path
    config: str
    split: str
    revision: str | None
    labyrinths: int | None
    where: Filter | None

    def locate(self, files: Iterable[str]) -> AnyPath:
        """Return the folder with the manifest and other files; see `locate`."""
        return locate(self.source, self.config, files, self.revision)


def find_part(wanted: Wanted, *, in_place: bool = False) -> Part:
    """Return a split or a part of it; from the Hub come only the shards that hold some of it.

    Args:
        wanted: The split or part of it.
        in_place: Whether shards on the Hub are not downloaded, but read where they are.

    Raises:
        ValueError, DatasetError: As for `load.load_episodes`.
    """
    if wanted.labyrinths is None and wanted.where is None and not in_place:
        folder = wanted.locate([f"{wanted.split}-*.parquet"])
        manifest = Manifest.read(folder)
        return Part(folder, manifest.of(wanted.split), config=manifest.config)
    folder = wanted.locate([])
    manifest = Manifest.read(folder)
    split = replace(wanted, labyrinths=None, where=None)
    part = Part(folder, manifest.of(wanted.split), config=manifest.config, whole=split)
    if local_folder(wanted.source, wanted.config, wanted.revision) is None:
        commit = folder.parent.name
        place = RemotePath(f"hf://datasets/{wanted.source}@{commit}/{wanted.config}")
        # What is read later is of the same commit.
        part = replace(part, place=place, whole=replace(split, revision=commit))
    part = replace(part, kept=_kept(wanted, part, manifest))
    if in_place:
        return part
    files = [part.shards[number].path for number in part.held()]
    return replace(part, folder=wanted.locate(files))


def _kept(wanted: Wanted, part: Part, manifest: Manifest) -> NDArray[np.bool_] | None:
    """Return which of a split's first rows are those of the labyrinths asked for, None for all."""
    labyrinths, where, split = wanted.labyrinths, wanted.where, wanted.split
    if labyrinths is None and where is None:
        return None
    count = left = sum(shard.labyrinths for shard in part.shards)
    if where is not None:
        ranges = _row_ranges(wanted, manifest)
        left = len(ranges)
    if labyrinths is not None:
        filtered = "" if where is None else f" where {where}"
        held = f"a whole number from 1 to {left}, as many as split={split} has{filtered}"
        left = whole("labyrinths", labyrinths, 1, left, allowed=held)
    if left == count:
        return None
    if where is None:
        ranges = _row_ranges(wanted, manifest)
    kept = np.zeros(part.first_rows()[-1], np.bool_)
    for first, end in ranges[:left].tolist():
        kept[first:end] = True
    return kept


def _row_ranges(wanted: Wanted, manifest: Manifest) -> NDArray[np.int64]:
    """Return the first row of each labyrinth asked for, and the end of its rows, shape (n, 2)."""
    import pyarrow as pa
    import pyarrow.compute as pc
    import pyarrow.parquet as pq

    split, where = wanted.split, wanted.where
    if where is not None and not isinstance(where, pc.Expression):
        raise ValueError(
            f"where={where!r:.99}: give an expression, such as pyarrow.compute.field('moves') >= 12"
        )
    own = pc.field("split") == split
    filters = own if where is None else own & where
    with table_file(wanted.locate([TABLE]), manifest) as path:
        try:
            table = pq.read_table(path, columns=["first_row", "rows"], filters=filters)
        except pa.ArrowException as error:
            if where is None:
                raise
            reason = str(error).partition(" in ")[0].partition("\n")[0]
            columns = ", ".join(column.name for column in TABLE_COLUMNS)
            raise ValueError(
                f"where={where}: {reason}; the columns of {TABLE} are {columns}"
            ) from error
    if where is not None and not len(table):
        raise ValueError(f"where={where}: split={split} has no such labyrinth")
    first_rows = table["first_row"].to_numpy()
    return np.stack([first_rows, first_rows + table["rows"].to_numpy()], axis=1)


def locate(
    source: str | Path, config: str, files: Iterable[str], revision: str | None = None
) -> AnyPath:
    """Return the folder with a dataset's manifest and other files, given by names or patterns.

    Files on the Hub are downloaded to its cache first; `../README.md` is the card of all configs.

    Raises:
        DatasetError: There is no such folder, or the Hub does not provide it.
    """
    return local_folder(source, config, revision) or _download(str(source), config, files, revision)


def local_folder(source: str | Path, config: str, revision: str | None) -> AnyPath | None:
    """Return the folder with a dataset's manifest, None for an id on the Hub.

    Raises:
        ValueError: A revision is given for a folder.
        DatasetError: The source is neither a folder nor an id, or has no such config.
    """
    try:
        folder = folder_at(source)
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

    from labyrinth_core.data.hub import UNAVAILABLE, limit_silence

    limit_silence()
    patterns = [normpath(f"{config}/{name}") for name in (MANIFEST, *files)]
    try:
        snapshot = snapshot_download(
            source, repo_type="dataset", revision=revision, allow_patterns=patterns
        )
        if _has_episodes(Path(snapshot, config)):
            return Path(snapshot) / config
        there = HfApi().list_repo_files(source, repo_type="dataset", revision=revision)
    except UNAVAILABLE as error:
        raise DatasetError(f"{why_unavailable(source, error)}: {one_line(error)}") from error
    manifests = (path for path in there if re.fullmatch(rf"[^/]+/{MANIFEST}", path))
    raise _no_config(source, config, manifests)


def why_unavailable(source: str, error: Exception) -> str:
    """Return why the Hub's client, or `datasets`, does not provide a dataset, given its error."""
    file = error.filename if isinstance(error, OSError) else None
    if file is not None and not Path(file).resolve().is_relative_to(Path(source).resolve()):
        return f"{source}: the cache of the Hub's client cannot be used (HF_HOME moves it)"
    if Path(source).is_dir():
        return f"{source} cannot be read"
    return f"{source} is no folder (labyrinth-datasets makes one), and not to be had from the Hub"


def _has_episodes(folder: AnyPath) -> bool:
    return (folder / MANIFEST).is_file() and not folder.name.endswith(f"-{QUESTIONS}")


def _no_config(source: str | Path, config: str, manifests: Iterable[str]) -> DatasetError:
    names = (path.split("/")[-2] for path in manifests)
    held = sorted(name for name in names if not name.endswith(f"-{QUESTIONS}"))
    none = f"none: a dataset has a {MANIFEST}, which `push_to_hub` of `datasets` leaves out"
    return DatasetError(f"config={config}: {source} holds {', '.join(held) or none}")

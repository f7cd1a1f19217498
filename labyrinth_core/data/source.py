"""Where a dataset lies, in a folder or on the Hub, and which part of a split is read from there."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import KW_ONLY, dataclass, replace
from pathlib import Path
from posixpath import normpath
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.data.dataset_config import QUESTIONS
from labyrinth_core.data.errors import DatasetError, one_line
from labyrinth_core.data.labyrinth_table import TABLE, TABLE_COLUMNS, table_file
from labyrinth_core.data.manifest import MANIFEST, Manifest
from labyrinth_core.data.part import Part
from labyrinth_core.data.rows import numbered
from labyrinth_core.data.storage import AnyPath, RemotePath, folder_at

if TYPE_CHECKING:
    from pyarrow.compute import Expression

HUB_ID = re.compile(r"(?!.*(--|\.\.))\w[\w.-]*/\w[\w.-]*", re.ASCII)

Filter: TypeAlias = "Expression"
"""A filter of the table of labyrinths, such as `pyarrow.compute.field("moves") >= 12`."""


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
    return DatasetError(f"config={config}: {source} holds {', '.join(held) or 'none'}")


@dataclass(frozen=True)
class Wanted:
    """A split or a part of it, as asked for; `loader.load_episodes` explains the fields."""

    source: str | Path
    config: str
    _: KW_ONLY
    split: str = "train"
    revision: str | None = None
    labyrinths: int | None = None
    where: Filter | None = None

    def locate(self, files: Iterable[str]) -> AnyPath:
        """Return the folder with the manifest and other files; see `locate`."""
        return locate(self.source, self.config, files, self.revision)


def find_part(wanted: Wanted, *, in_place: bool = False) -> Part:
    """Return a split or a part of it; from the Hub come only the shards that hold some of it.

    Args:
        wanted: What is asked for.
        in_place: Whether shards on the Hub are not downloaded, but read where they are.

    Raises:
        ValueError, DatasetError: As for `loader.load_episodes`.
    """
    if wanted.labyrinths is None and wanted.where is None and not in_place:
        folder = wanted.locate([f"{wanted.split}-*.parquet"])
        manifest = Manifest.read(folder)
        return Part(folder, manifest.config.name, manifest.of(wanted.split))
    folder = wanted.locate([])
    manifest = Manifest.read(folder)
    part = Part(folder, manifest.config.name, manifest.of(wanted.split))
    if local_folder(wanted.source, wanted.config, wanted.revision) is None:
        commit = folder.parent.name
        place = RemotePath(f"hf://datasets/{wanted.source}@{commit}/{wanted.config}")
        part = replace(part, place=place)
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
    count = sum(shard.labyrinths for shard in part.shards)
    numbers = np.arange(count)
    if where is not None:
        numbers = _filtered(wanted.locate([TABLE]), manifest, split, where)
    if labyrinths is not None:
        whole = isinstance(labyrinths, int | np.integer) and not isinstance(labyrinths, bool)
        if not whole or not 1 <= labyrinths <= len(numbers):
            filtered = "" if where is None else f" where {where}"
            raise ValueError(
                f"labyrinths={labyrinths!r:.99}: give a whole number from 1 to {len(numbers)}, as "
                f"many as split={split} has{filtered}"
            )
        numbers = numbers[:labyrinths]
    if len(numbers) == count:
        return None
    if manifest.labyrinths is None:
        number = _numbers_of_rows(part, int(numbers[-1]))
    else:
        rows = _rows_of_labyrinths(wanted.locate([TABLE]), manifest, split)
        number = np.repeat(np.arange(len(rows)), rows)
    return np.isin(number, numbers)


def _numbers_of_rows(part: Part, last: int) -> NDArray[np.int64]:
    """Return the number of the labyrinth in each row up to the last row of a labyrinth."""
    numbers = []
    for _, number in numbered(part.rows(pictures=False)):
        numbers.append(number)
        if number[-1] > last:
            break
    return np.concatenate(numbers)


def _rows_of_labyrinths(folder: AnyPath, manifest: Manifest, split: str) -> NDArray[np.int64]:
    """Return the number of rows of each labyrinth of a split."""
    import pyarrow.compute as pc
    import pyarrow.parquet as pq

    with table_file(folder, manifest) as path, pq.ParquetFile(path) as file:
        table = file.read(["split", "rows"])
    return table.filter(pc.equal(table["split"], split))["rows"].to_numpy()  # type: ignore[no-any-return]


def _filtered(folder: AnyPath, manifest: Manifest, split: str, where: Any) -> NDArray[np.int64]:
    """Return the numbers of the labyrinths of a split that a filter leaves, ascending."""
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
    numbers: NDArray[np.int64] = np.searchsorted(every, kept["first_row"].to_numpy())
    if not len(numbers):
        raise ValueError(f"where={where}: split={split} has no such labyrinth")
    return numbers

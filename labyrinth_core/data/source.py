"""The rows of a dataset, read from a folder or from the Hub, or streamed."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from itertools import chain, groupby
from pathlib import Path
from posixpath import normpath
from typing import TYPE_CHECKING, Any, NamedTuple

from labyrinth_core.data.columns import footer_problem, open_shard, tables_of, texts
from labyrinth_core.data.errors import DatasetError, one_line
from labyrinth_core.data.manifest import MANIFEST, Shard
from labyrinth_core.data.storage import AnyPath, file_sha256, folder_at, local_copy

if TYPE_CHECKING:
    import pyarrow as pa
    import pyarrow.parquet

HUB_ID = re.compile(r"(?!.*(--|\.\.))\w[\w.-]*/\w[\w.-]*", re.ASCII)
TYPES = {"actions": int, "rewards": float, "episode_starts": bool, "info": str}
"""Column -> what its values are, the pictures left out."""


class RawRow(NamedTuple):
    """A row as it was read, with values of the right types."""

    actions: int
    rewards: float
    episode_starts: bool
    info: str
    png: bytes | None
    """The picture; None if the row has none, or none was asked for."""


def locate(
    source: str | Path, config: str, files: Iterable[str], revision: str | None = None
) -> AnyPath:
    """Return the folder with a dataset's manifest and other files, given by names or patterns.

    For an id on the Hub they are downloaded to its cache first; `../README.md` is that of all.

    Raises:
        DatasetError: There is no such folder, or the Hub does not give it.
    """
    return local_folder(source, config, revision) or _download(str(source), config, files, revision)


def local_folder(source: str | Path, config: str, revision: str | None) -> AnyPath | None:
    """Return the folder with a dataset's manifest, None for an id on the Hub.

    Raises:
        ValueError: There is a revision, but a folder has none.
        DatasetError: The source is neither, or has no such config.
    """
    try:
        folder = folder_at(source)
    except ValueError as error:
        raise DatasetError(str(error)) from error
    if folder.is_dir():
        if revision is not None:
            raise ValueError(f"revision={revision}: {source} is a folder, which has no revisions")
        if not (folder / config / MANIFEST).is_file():
            if (folder / MANIFEST).is_file():
                raise DatasetError(
                    f"{source} is the folder of the config {folder.name}: give the folder that "
                    f"holds it, {folder.parent}"
                )
            raise _not_held(source, config, map(str, folder.glob(f"*/{MANIFEST}")))
        return folder / config
    if not HUB_ID.fullmatch(str(source)):
        raise DatasetError(f"{source} is neither a folder nor an id such as user/labyrinth")
    return None


def _download(source: str, config: str, files: Iterable[str], revision: str | None) -> Path:
    from huggingface_hub import HfApi, snapshot_download

    patterns = [normpath(f"{config}/{name}") for name in (MANIFEST, *files)]
    with _had(source):
        snapshot = snapshot_download(
            source, repo_type="dataset", revision=revision, allow_patterns=patterns
        )
        if not Path(snapshot, config, MANIFEST).is_file():
            there = HfApi().list_repo_files(source, repo_type="dataset", revision=revision)
            manifests = (path for path in there if re.fullmatch(rf"[^/]+/{MANIFEST}", path))
            raise _not_held(source, config, manifests)
    return Path(snapshot) / config


def _not_held(source: str | Path, config: str, manifests: Iterable[str]) -> DatasetError:
    held = sorted(path.split("/")[-2] for path in manifests)
    return DatasetError(f"config={config}: {source} holds {', '.join(held) or 'none'}")


def read_rows(folder: AnyPath, shards: Iterable[Shard], *, pictures: bool) -> Iterator[RawRow]:
    """Yield the rows of shards that are what their manifest says, one row group at a time.

    Raises:
        DatasetError: A shard is missing, damaged or another one.
    """
    columns = [*TYPES, "obs.bytes"] if pictures else [*TYPES]
    for shard in shards:
        with opened(folder, shard) as file:
            for table in tables_of(file, columns):
                yield from _rows(table, pictures=pictures)


@contextmanager
def opened(folder: AnyPath, shard: Shard) -> Iterator[pyarrow.parquet.ParquetFile]:
    """Open a shard that is what its manifest says; what goes wrong within is a DatasetError."""
    path = folder / shard.path
    with _readable(path), local_copy(path) as local:
        check_file(local, shard, path)
        with open_shard(local) as file:
            problem = footer_problem(file, shard.rows)
            if problem is not None:
                raise DatasetError(f"{path} is damaged: {problem}")
            yield file


def check_file(file: AnyPath, shard: Shard, path: AnyPath) -> None:
    """Raise DatasetError if a file is not the shard whose path it has, or is a copy of."""
    if file_sha256(file) != shard.sha256:
        raise DatasetError(
            f"{path} is damaged: its sha256 is not the manifest's; "
            "delete it, and build or download it again"
        )


def stream_rows(
    source: str, config: str, split: str, revision: str | None, *, pictures: bool
) -> Iterator[RawRow]:
    """Return the rows of a split as they are downloaded, wherever its files end.

    Raises:
        DatasetError: At once if there is no such dataset, later if it cannot be read.
    """
    from datasets import Image, load_dataset

    # `datasets` casts a selection of columns to their declared types, and leaves all as they are.
    columns = None if pictures else [*TYPES]
    with _had(source):
        stream = load_dataset(
            source, config, split=split, streaming=True, revision=revision, columns=columns
        )
        if pictures:
            # As bytes, since `datasets` would decode them, too.
            stream = stream.cast_column("obs", Image(decode=False))
    return (row for table in _tables(source, stream) for row in _rows(table, pictures=pictures))


def stream_infos(source: str, config: str | None) -> dict[str, Iterator[str]]:
    """Return the values of `info` in each split of any dataset, as they are downloaded.

    No other column is downloaded. Equal values in consecutive rows come once.

    Raises:
        DatasetError: At once if there is no such dataset, later if it cannot be read.
    """
    from datasets import load_dataset

    with _had(source):
        splits = load_dataset(source, config, streaming=True, columns=["info"])
    return {str(split): _infos(source, stream) for split, stream in splits.items()}


def _infos(source: str, stream: Any) -> Iterator[str]:
    with _readable(source):
        rows = chain.from_iterable(t["info"].to_pylist() for t in _tables(source, stream))
        for info, _ in groupby(rows):
            if not isinstance(info, str):
                raise DatasetError(f"{source}: info={info!r}: every row needs a text")
            yield info


def _tables(source: str, stream: Any) -> Iterator[pa.Table]:
    """Yield the tables of a stream of `datasets`."""
    with _readable(source):
        yield from stream.with_format("arrow").iter(batch_size=256)


@contextmanager
def _readable(place: object) -> Iterator[None]:
    """Raise DatasetError for what is raised within when files at a place cannot be read."""
    import pyarrow as pa

    try:
        yield
    except MemoryError:  # Of Arrow, too; nothing is wrong with the files.
        raise
    except (OSError, ValueError, LookupError, pa.ArrowException) as error:
        raise DatasetError(f"{place} cannot be read: {one_line(error)}") from error


def _rows(table: pa.Table, *, pictures: bool) -> Iterator[RawRow]:
    """Yield the rows of a table, after its columns were checked as a whole."""
    import pyarrow.compute as pc

    def values(name: str) -> list[Any]:
        if name not in table.column_names:
            return [None] * table.num_rows
        return texts(table[name]) if name == "info" else table[name].to_pylist()

    columns = {name: values(name) for name in TYPES}
    for name, kind in TYPES.items():
        wrong = [value for value in columns[name] if type(value) is not kind]
        if wrong:
            raise DatasetError(f"{name}={wrong[0]!r}: every row needs {kind.__name__}")
    pngs: list[Any] = [None] * table.num_rows
    if pictures and "obs" in table.column_names:
        pngs = pc.struct_field(table["obs"], "bytes").cast("binary").to_pylist()
    yield from map(RawRow, *columns.values(), pngs)


@contextmanager
def _had(source: str) -> Iterator[None]:
    """Raise DatasetError for what is raised within when a dataset is not to be had."""
    import yaml

    try:
        yield
    except (OSError, ValueError, yaml.YAMLError) as error:
        reason = (
            f"{source} is no folder (labyrinth-datasets makes one), and not to be had from the Hub"
        )
        file = error.filename if isinstance(error, OSError) else None
        if file is not None and not Path(file).resolve().is_relative_to(Path(source).resolve()):
            reason = f"{source}: the cache of the Hub's client cannot be used (HF_HOME moves it)"
        elif isinstance(error, yaml.YAMLError):
            reason = f"{source}: the front matter of its README.md cannot be read"
        elif "BuilderConfig" in str(error):  # One that is not there; the message lists the others.
            reason = source
        elif Path(source).is_dir():
            reason = f"{source} cannot be read"
        raise DatasetError(f"{reason}: {one_line(error)}") from error

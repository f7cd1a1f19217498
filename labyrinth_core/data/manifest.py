"""The manifest, which describes a finished dataset, and the errors of reading its files.

The manifest is written last, so a folder with a manifest is complete.

What a file says of itself is compared with what was asked for when it is opened, before memory is
taken for it. `Manifest.read` compares the dataset's name with its folder, and the rows of shards
with their bytes; `LabyrinthTable.opened` and `rows.opened` compare a file's hash, size and footer
with the manifest, and say whether the dataset was replaced meanwhile (`unless_replaced`). Jobs that
read several splits end with `Dataset.require_unchanged`.
"""

from __future__ import annotations

import hashlib
import json
import re
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, TypeVar, get_type_hints

from labyrinth_core.data.dataset_config import SPLITS, DatasetConfig, check_fields
from labyrinth_core.data.format import GROUP_BYTES, NO_ACTION
from labyrinth_core.errors import DatasetError, one_line, printable
from labyrinth_core.storage import AnyPath, File
from labyrinth_core.version import __version__

if TYPE_CHECKING:
    from pyarrow.parquet import ParquetFile

MOST = 10**15
"""The largest count that a manifest may hold."""
AGAIN = "build it again with the same command, or download it again"
"""Advice for a missing or damaged file of a dataset; a build makes such files again."""

REBUILD = "build it again with overwrite=true, or download it again"
"""Advice for a dataset whose manifest is of no use."""
Result = TypeVar("Result")
FORMAT, FORMAT_OF_CHUNKS = 2, 3
"""The format of a manifest, and its format if structures come from several chunks of
candidates."""


ROW_GROUP = 256
"""A row group with this many rows ends at the next end of an episode."""

MOST_ROWS, MOST_BYTES = GROUP_BYTES // 512, 4 * GROUP_BYTES
"""The most rows and uncompressed bytes of a row group; every picture has at least 512 bytes."""

MOST_TEXTS = 16 << 20
"""The most uncompressed bytes of `info` in a row group: ten times those at 300x300."""


@dataclass(frozen=True)
class Shard:
    """One Parquet file and its content."""

    path: str
    """The path within the folder of the dataset."""
    split: str
    labyrinths: int
    episodes: int
    rows: int
    longest: int
    """The number of moves in the longest episode."""
    cut: int
    """The number of labyrinths that have, or may have, more routes than `solutions_limit`."""
    bytes: int
    sha256: str
    """The SHA-256 of the file."""
    fingerprint: str
    """The hash of the decoded rows."""

    @classmethod
    def from_json(cls, values: Mapping[str, Any]) -> Shard:
        """Return the shard that `asdict` described; raise ValueError for anything else."""
        shard = cls(**_counted(values, cls, "a shard"))
        if shard.split not in SPLITS or not re.fullmatch(
            rf"{shard.split}-\d{{5,}}-of-\d{{5,}}\.parquet", shard.path, re.ASCII
        ):
            raise ValueError(f"split {shard.split!r} cannot have a shard {shard.path!r}")
        # No memory is taken for rows that the file cannot hold: a row takes 12 bytes at least, the
        # pictures of a random policy at 2x2.
        if shard.rows > shard.bytes:
            raise ValueError(f"{shard.path} has {shard.rows} rows in {shard.bytes} bytes")
        return shard

    def footer_problem(self, file: ParquetFile) -> str | None:
        """Return why the footer of a file is not this shard's, before any row is read; else None.

        A few bytes may decompress to any number of rows, and a row group is read as a whole.
        """
        rows = self.rows
        footer = file.metadata
        groups = [footer.row_group(number) for number in range(footer.num_row_groups)]
        if not rows == footer.num_rows == sum(group.num_rows for group in groups):
            return f"rows {footer.num_rows}, but the manifest says {rows}"
        for group in groups:
            if group.num_rows > MOST_ROWS:
                return f"a row group has {group.num_rows} rows, more than {MOST_ROWS}"
            if group.total_byte_size > MOST_BYTES:
                return f"a row group has {group.total_byte_size} bytes, more than {MOST_BYTES}"
            if group.total_byte_size <= MOST_TEXTS:
                continue
            columns = map(group.column, range(group.num_columns))
            texts = (column for column in columns if column.path_in_schema == "info")
            size = sum(column.total_uncompressed_size for column in texts)
            if size > MOST_TEXTS:
                return f"a row group has {size} bytes of texts, more than {MOST_TEXTS}"
        return None

    @staticmethod
    def ends_group(rows: int, picture_bytes: int, action: int) -> bool:
        """Return whether a writer ends a row group with a row.

        Args:
            rows: The number of rows in the group.
            picture_bytes: The size of the last row's picture.
            action: The last row's `actions`.
        """
        is_full = action == NO_ACTION and rows >= ROW_GROUP
        return is_full or rows * picture_bytes >= GROUP_BYTES


@dataclass(frozen=True)
class TableFile:
    """The table of labyrinths, the file `TABLE`."""

    bytes: int
    sha256: str
    """The SHA-256 of the file."""

    @classmethod
    def from_json(cls, values: Mapping[str, Any]) -> TableFile:
        """Return the table that `asdict` described; raise ValueError for anything else."""
        return cls(**_counted(values, cls, "a table"))


@cache
def _fields_of(kind: type) -> Mapping[str, Any]:
    """Return the types of a dataclass's fields; cached, since finding them takes 0.3 ms."""
    return get_type_hints(kind)


def _counted(values: Mapping[str, Any], kind: type, name: str) -> Mapping[str, Any]:
    """Return `values`; raise ValueError unless they are the fields of `kind`, with valid counts."""
    check_fields(values, _fields_of(kind), name)
    for count_name, value in values.items():
        if isinstance(value, int) and not 0 <= value <= MOST:
            raise ValueError(f"{name} has {count_name}={value}, not a number from 0 to {MOST}")
    return values


@dataclass(frozen=True)
class Manifest:
    """The description of a finished dataset."""

    FILE: ClassVar[str] = "manifest.json"
    ANALYSIS: ClassVar[str] = "analysis.json"
    """The file of the stage `analyse`, in the same folder."""
    TABLE: ClassVar[str] = "labyrinths.parquet"
    """The table of labyrinths, in the same folder; it has one row for each labyrinth.

    The rows are in the order of the splits and of their rows; `format.TABLE_COLUMNS` are the
    columns. On the Hub the table is a config of its own, such as `5x5-labyrinths`.
    """

    config: DatasetConfig
    versions: Mapping[str, str]
    """Library -> version; other versions may compress the same rows differently."""
    shards: tuple[Shard, ...]
    """The shards, in the order of splits and of rows."""
    labyrinths: TableFile | None = None
    """The table of labyrinths; None in the manifest of a companion, or before it is made."""
    format: int = FORMAT
    companions: Mapping[str, Manifest] = field(default_factory=dict)
    """The manifests of the configs that stages wrote beside the dataset about its labyrinths, files
    of their own, by the suffix of their names, such as `questions`. Their shards have the names and
    fingerprints of the shards they were made from."""

    @staticmethod
    def current_versions() -> dict[str, str]:
        """Return the versions of the installed software that determines the bytes of a dataset."""
        import zlib
        from importlib.metadata import version

        import numpy as np

        from labyrinth_core.pictures import ENCODER

        return {
            "labyrinth-datasets": __version__,
            "numpy": np.__version__,
            "pyarrow": version("pyarrow"),
            "zlib": zlib.ZLIB_RUNTIME_VERSION,
            "png": ENCODER,
        }

    @property
    def is_of_current_versions(self) -> bool:
        """Whether the installed software would write the same rows as the same bytes."""
        return dict(self.versions) == Manifest.current_versions()

    @classmethod
    def of_build(
        cls, config: DatasetConfig, shards: tuple[Shard, ...], *, in_one_chunk: bool
    ) -> Manifest:
        """Return the manifest of a new dataset, which lacks its table; see `with_table`.

        Its format tells whether there was one chunk of candidates.
        """
        form = FORMAT if in_one_chunk else FORMAT_OF_CHUNKS
        return cls(config, cls.current_versions(), shards, format=form)

    def with_table(self, path: Path) -> Manifest:
        """Return the manifest with a file as the table of labyrinths."""
        return replace(self, labyrinths=TableFile(path.stat().st_size, File(path).sha256()))

    @property
    def table(self) -> TableFile:
        """The table of labyrinths, which the manifest of a companion lacks."""
        assert self.labyrinths is not None
        return self.labyrinths

    @property
    def fingerprint(self) -> str:
        """The fingerprint of all rows of all splits."""
        parts = [f"{shard.split}:{shard.fingerprint}" for shard in self.shards]
        return hashlib.sha256("\n".join(parts).encode()).hexdigest()

    def of(self, split: str) -> list[Shard]:
        """Return the shards of a split.

        Raises:
            DatasetError: The dataset has no such split.
        """
        shards = [shard for shard in self.shards if shard.split == split]
        if not shards:
            held = dict.fromkeys(shard.split for shard in self.shards)
            raise DatasetError(f"split={split}: the dataset has {', '.join(held)}")
        return shards

    def write(self, folder: AnyPath) -> None:
        """Write the manifest into a folder, whole or not at all."""
        content = {
            "format": self.format,
            "name": self.config.name,
            "config": self.config.to_json(),
            "versions": dict(self.versions),
            "fingerprint": self.fingerprint,
            "shards": [asdict(shard) for shard in self.shards],
        }
        if self.labyrinths is not None:
            content["labyrinths"] = asdict(self.labyrinths)
        File(folder / Manifest.FILE).write_text(json.dumps(content, indent=2) + "\n")

    @classmethod
    def read(cls, folder: AnyPath, *, renamed: bool = False, companion: str = "") -> Manifest:
        """Return the manifest of a folder.

        Args:
            folder: The folder of a dataset, or of a companion of one.
            renamed: Whether the folder may have another name than the dataset in it.
            companion: The suffix of the companion's name; empty for a dataset. A companion has no
                table of labyrinths.

        Raises:
            DatasetError: The manifest is missing or malformed, or of a dataset of another name.
        """
        path = folder / Manifest.FILE
        try:
            content = File(path).read_json()
            _require(content, {"format": object})
            form = content["format"]
            if form in (FORMAT, FORMAT_OF_CHUNKS):
                kinds = {"config": dict, "versions": dict, "shards": list}
                _require(content, kinds if companion else kinds | {"labyrinths": object})
                manifest = cls(
                    config=DatasetConfig.from_json(content["config"]),
                    versions={str(key): str(value) for key, value in content["versions"].items()},
                    shards=tuple(Shard.from_json(shard) for shard in content["shards"]),
                    labyrinths=None if companion else TableFile.from_json(content["labyrinths"]),
                    format=form,
                )
                if content.get("fingerprint") != manifest.fingerprint:
                    raise ValueError("its fingerprint is not that of its shards")
        except (FileNotFoundError, NotADirectoryError) as error:
            raise DatasetError(f"{folder} holds no finished dataset: no {Manifest.FILE}") from error
        except OSError as error:
            raise DatasetError(f"{path} cannot be read: {one_line(error)}") from error
        except (ValueError, RecursionError) as error:
            # Not chained: the message of `error` may hold control characters from the file.
            reason = printable(one_line(error))[:200]
            raise DatasetError(f"{path} cannot be read: {reason}; {REBUILD}") from None
        if form not in (FORMAT, FORMAT_OF_CHUNKS):
            raise DatasetError(
                f"{path} has format {form!r:.60}, and this version reads {FORMAT} and "
                f"{FORMAT_OF_CHUNKS}: use the version that built the dataset, or {REBUILD}"
            )
        named = f"{manifest.config.name}-{companion}" if companion else manifest.config.name
        if named != folder.name and not renamed:
            raise DatasetError(
                f"{folder} holds the dataset {named}, not {folder.name}: give the folder the name "
                f"{named}, or {REBUILD}"
            )
        return manifest


def _require(content: Any, kinds: Mapping[str, type]) -> None:
    """Raise ValueError unless a JSON value is an object with these fields of these types."""
    foreign = "it is not the manifest of a dataset"
    if not isinstance(content, dict):
        raise ValueError(foreign)
    for name, kind in kinds.items():
        if name not in content:
            raise ValueError(f"it has no {name!r}")
        if not isinstance(content[name], kind):
            raise ValueError(foreign)


def replaced(folder: object) -> DatasetError:
    """Return the error for a dataset that was replaced while a job read it."""
    return DatasetError(f"{folder} was replaced or grew while it was read: run this again")


@contextmanager
def unless_replaced(folder: AnyPath, file: Shard | TableFile) -> Iterator[None]:
    """Say so if a DatasetError inside the block comes from a dataset that was replaced.

    Args:
        folder: The folder of the dataset.
        file: The file that is read, from the manifest that was read before.
    """
    try:
        yield
    except DatasetError as error:
        if not _lists(folder, file):
            raise replaced(folder) from error
        raise


def _lists(folder: AnyPath, file: Shard | TableFile) -> bool:
    """Return whether the manifest in a folder lists a file; also true if it is damaged."""
    try:
        manifest = Manifest.read(folder, renamed=True)
    except DatasetError:
        return (folder / Manifest.FILE).is_file()
    return file in (*manifest.shards, manifest.labyrinths)


def mended(path: AnyPath, check: Callable[[], Result]) -> Result:
    """Return the result of checking a file; a damaged one from the Hub is downloaded once more.

    Raises:
        DatasetError: The check fails, for a file from the Hub twice.
    """
    try:
        return check()
    except DatasetError:
        if "snapshots" not in str(path):  # Not of the cache of the Hub's client.
            raise
        from labyrinth_core import hub

        if not hub.download_again(Path(str(path))):
            raise
    return check()


@contextmanager
def readable(name: object) -> Iterator[None]:
    """Turn a read error inside the block into a DatasetError that names `name`.

    Only calls of Arrow and of storage belong in the block. In code that works with their results,
    a bug would pass for a damaged file.
    """
    import pyarrow as pa

    try:
        yield
    except MemoryError:  # The file is fine, though Arrow's MemoryError is an ArrowException.
        raise
    except Exception as error:
        # Not imported here: without free file descriptors, the import would fail instead.
        hub = sys.modules.get("huggingface_hub.errors")
        of_hub = () if hub is None else (hub.HTTPError,)
        if isinstance(error, FileNotFoundError):
            raise DatasetError(f"{name} is missing: {AGAIN}") from error
        if isinstance(error, (OSError, ValueError, pa.ArrowException, *of_hub)):
            raise DatasetError(f"{name} cannot be read: {one_line(error)}") from error
        raise

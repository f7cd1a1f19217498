"""The manifest, which describes a finished dataset, and the table of labyrinths beside it.

The manifest is written last, so a folder with a manifest is complete.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from functools import cache
from pathlib import Path
from typing import Any, get_type_hints

from labyrinth_core.data.dataset_config import DatasetConfig, check_fields
from labyrinth_core.data.errors import MALFORMED, DatasetError, one_line
from labyrinth_core.data.splits import SPLITS
from labyrinth_core.data.storage import AnyPath, file_sha256, local_copy, read_json, write_text

MANIFEST = "manifest.json"
ANALYSIS = "analysis.json"
"""The file of the stage `analyse`, in the same folder."""
TABLE = "labyrinths.parquet"
"""The name of the table of labyrinths, in the same folder; it has one row for each labyrinth.

The rows are in the order of the splits and of their rows; `format.TABLE_COLUMNS` are the columns.
On the Hub the table is a config of its own, such as `5x5-labyrinths`.
"""
MOST = 10**15
"""The largest count that a manifest may hold."""
FORMAT, FORMAT_OF_CHUNKS = 2, 3
"""The format of a manifest, and its format if structures come from several chunks of
candidates."""


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
        return shard


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
    for each, value in values.items():
        if isinstance(value, int) and not 0 <= value <= MOST:
            raise ValueError(f"{name} has {each}={value}, not a number from 0 to {MOST}")
    return values


@dataclass(frozen=True)
class Manifest:
    """The description of a finished dataset."""

    config: DatasetConfig
    versions: Mapping[str, str]
    """Library -> version; other versions may compress the same rows differently."""
    shards: tuple[Shard, ...]
    """The shards, in the order of splits and of rows."""
    labyrinths: TableFile | None = None
    """The table of labyrinths; None in the manifest of a companion."""
    format: int = FORMAT
    companions: Mapping[str, Manifest] = field(default_factory=dict)
    """The manifests of the configs that stages wrote beside the dataset about its labyrinths, files
    of their own, by the suffix of their names, such as `questions`. Their shards have the names and
    fingerprints of the shards they were made from."""

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
        write_text(folder / MANIFEST, json.dumps(content, indent=2) + "\n")

    @classmethod
    def read(cls, folder: AnyPath, *, has_table: bool = True) -> Manifest:
        """Return the manifest of a folder.

        Args:
            folder: The folder.
            has_table: Whether the folder has a table of labyrinths, as all but companions do.

        Raises:
            DatasetError: The manifest is missing or malformed.
        """
        path = folder / MANIFEST
        try:
            content = read_json(path)
            if content["format"] not in (FORMAT, FORMAT_OF_CHUNKS):
                raise ValueError(
                    f"its format is {content['format']}, not {FORMAT} or {FORMAT_OF_CHUNKS}"
                )
            return cls(
                config=DatasetConfig.from_json(content["config"]),
                versions={str(key): str(value) for key, value in content["versions"].items()},
                shards=tuple(Shard.from_json(shard) for shard in content["shards"]),
                labyrinths=TableFile.from_json(content["labyrinths"]) if has_table else None,
                format=content["format"],
            )
        except (FileNotFoundError, NotADirectoryError) as error:
            raise DatasetError(f"{folder} holds no finished dataset: no {MANIFEST}") from error
        except (OSError, *MALFORMED) as error:
            raise DatasetError(f"{path} cannot be read: {error!r:.500}") from error


@contextmanager
def table_file(folder: AnyPath, manifest: Manifest) -> Iterator[Path]:
    """Yield a local path of the table of labyrinths, after checking its hash.

    Raises:
        DatasetError: The table is missing or damaged, or the caller cannot read it.
    """
    import pyarrow as pa

    path = folder / TABLE
    try:
        with local_copy(path) as local:
            if file_sha256(local) != manifest.table.sha256:
                raise DatasetError(f"{path} is damaged: its sha256 is not the manifest's")
            yield local
    except (OSError, pa.ArrowException) as error:
        raise DatasetError(f"{path} cannot be read: {one_line(error)}") from error

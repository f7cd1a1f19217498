"""The manifest, which describes a finished dataset.

It is written last, so a folder with a manifest is complete.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any

from labyrinth_core.data.dataset_config import QUESTIONS, DatasetConfig
from labyrinth_core.data.errors import MALFORMED, DatasetError
from labyrinth_core.data.schema import COUNT, Exactly, Text, check_shape, read_json
from labyrinth_core.data.splits import SPLITS
from labyrinth_core.data.storage import AnyPath, write_text

MANIFEST = "manifest.json"
ANALYSIS = "analysis.json"
"""The name of the file of the stage `analyse`, in the same folder."""
"""The name of the file of what is counted in the rows, in the same folder."""
FORMAT, FORMAT_OF_CHUNKS = 2, 3
"""The format of a manifest, and that of one whose structures come from several chunks of
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
        check_shape(values, _SHARD, "a shard")
        shard = cls(**values)
        if shard.split not in SPLITS or not re.fullmatch(
            rf"{shard.split}-\d{{5,}}-of-\d{{5,}}\.parquet", shard.path, re.ASCII
        ):
            raise ValueError(f"no split {shard.split!r} has a shard {shard.path!r}")
        return shard


_TEXT = Text("(?s).*")
_SHARD = Exactly({each.name: _TEXT if each.type == "str" else COUNT for each in fields(Shard)})
"""The shape of a `Shard`."""


@dataclass(frozen=True)
class TableFile:
    """The table of labyrinths, see `labyrinth_table`."""

    bytes: int
    sha256: str
    """The SHA-256 of the file."""

    @classmethod
    def from_json(cls, values: Mapping[str, Any]) -> TableFile:
        """Return the table that `asdict` described; raise ValueError for anything else."""
        check_shape(values, Exactly({"bytes": COUNT, "sha256": _TEXT}), "a table")
        return cls(**values)


@dataclass(frozen=True)
class Manifest:
    """The description of a finished dataset."""

    config: DatasetConfig
    versions: Mapping[str, str]
    """Library -> version; other versions may compress the same rows differently."""
    shards: tuple[Shard, ...]
    """The shards, in the order of splits and of rows."""
    labyrinths: TableFile | None = None
    """The table of labyrinths; that of questions has none."""
    format: int = FORMAT
    questions: Manifest | None = None
    """That of the questions beside the dataset, which is a file of its own, if there are any. Their
    shards have the names and fingerprints of those that they were made from."""

    @property
    def table(self) -> TableFile:
        """The table of labyrinths of a dataset that is not one of questions."""
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
            DatasetError: There is no such split.
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
    def read(cls, folder: AnyPath) -> Manifest:
        """Return the manifest of a folder.

        Raises:
            DatasetError: The manifest is missing or malformed.
        """
        path, asks = folder / MANIFEST, folder.name.endswith(f"-{QUESTIONS}")
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
                labyrinths=None if asks else TableFile.from_json(content["labyrinths"]),
                format=content["format"],
            )
        except (FileNotFoundError, NotADirectoryError) as error:
            raise DatasetError(f"{folder} holds no finished dataset: no {MANIFEST}") from error
        except (OSError, *MALFORMED) as error:
            raise DatasetError(f"{path} cannot be read: {error!r:.500}") from error

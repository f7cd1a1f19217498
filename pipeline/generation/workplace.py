"""The folders in which a dataset is built, and the commit that makes it whole at once."""

from __future__ import annotations

import json
import os
import re
import shutil
from dataclasses import dataclass
from pathlib import Path

from labyrinth_core.data.dataset_config import DatasetConfig
from labyrinth_core.data.errors import DatasetError
from labyrinth_core.data.labyrinth_table import TABLE
from labyrinth_core.data.manifest import (
    ANALYSIS,
    COUNTS,
    MANIFEST,
    Manifest,
    Shard,
    current_versions,
)
from labyrinth_core.data.storage import (
    AnyPath,
    RemotePath,
    file_sha256,
    size_and_time,
    write_text,
)
from pipeline.machinery.folders import move_into_place, recover, wait_for_disk

_CONFIG = "config.json"
_SHARD = re.compile(r"\w+-\d{5,}-of-\d{5,}\.parquet", re.ASCII)
_UNFINISHED = re.compile(r"\..+\.tmp")
"""A file that a process was killed over; see `storage.write_bytes`."""


@dataclass(frozen=True)
class Workplace:
    """The folders of one dataset: one for its shards, one for their sidecars."""

    folder: AnyPath
    """The folder of the finished dataset."""

    @classmethod
    def of(cls, folder: AnyPath) -> Workplace:
        """Return the workplace of a folder, beside the folder itself if a link leads to it."""
        is_link = isinstance(folder, Path) and folder.is_symlink()
        return cls(Path(os.path.realpath(str(folder))) if is_link else folder)

    @property
    def building(self) -> AnyPath:
        """The folder of the configuration, and of the sidecar of each finished shard."""
        return self.folder.parent / f".{self.folder.name}.building"

    @property
    def shards(self) -> AnyPath:
        """The folder in which shards are made: the final one in a store, which cannot rename."""
        return self.folder if isinstance(self.folder, RemotePath) else self.building / "shards"

    def recover(self) -> None:
        """Put the old dataset back if a crash in `commit` displaced it."""
        if isinstance(self.folder, Path):
            recover(self.folder)

    def refuse_others_files(self) -> None:
        """Raise DatasetError if there are files in the folder's place that no dataset has.

        A dataset has its manifest, its shards, and what its analysis leaves.
        """
        if not self.folder.exists():
            return
        if not self.folder.is_dir():
            raise DatasetError(f"{self.folder} is a file: move it, or choose another data_dir")
        names = sorted(path.name for path in self.folder.iterdir())
        if others := [name for name in names if not _may_be_ours(name)]:
            more = f" and {len(others) - 3} more" if len(others) > 3 else ""
            raise DatasetError(
                f"{self.folder} holds {', '.join(others[:3])}{more}, which would be lost, being no "
                "part of a dataset: move it elsewhere, or choose another data_dir"
            )

    def damaged(self, manifest: Manifest) -> list[Shard]:
        """Return the shards of the finished dataset that are missing, or not what they were.

        A file is hashed if it was written after the manifest, which is the last to be written.
        """
        return [
            shard
            for shard in manifest.shards
            if not self._is_whole(shard.path, shard.bytes, shard.sha256)
        ]

    def has_table(self, manifest: Manifest) -> bool:
        """Return whether the table of labyrinths is what it was, or the dataset never had one."""
        table = manifest.labyrinths
        return table is None or self._is_whole(TABLE, table.bytes, table.sha256)

    def _is_whole(self, name: str, size: int, sha256: str) -> bool:
        path, manifest = self.folder / name, self.folder / MANIFEST
        try:
            found, changed = size_and_time(path)
            if found != size:
                return False
            return changed < size_and_time(manifest)[1] or file_sha256(path) == sha256
        except FileNotFoundError:
            return False

    def prepare(self, config: DatasetConfig) -> None:
        """Make the folders, emptied of what another configuration or version left in them."""
        if isinstance(self.folder, RemotePath):  # The old manifest would describe new shards.
            (self.folder / MANIFEST).unlink(missing_ok=True)
        if not self.is_for(config):
            self.clear()
            for path in self.shards.glob("*.parquet"):
                if _SHARD.fullmatch(path.name) or path.name == TABLE:
                    path.unlink()
            self.building.mkdir(parents=True, exist_ok=True)
            write_text(self.building / _CONFIG, _content(config))
        self.shards.mkdir(parents=True, exist_ok=True)
        if isinstance(self.shards, Path):
            for path in self.shards.glob(".*.tmp"):  # A run was killed while it wrote the manifest.
                path.unlink()

    @property
    def has_begun(self) -> bool:
        """Whether a build was stopped here."""
        return (self.building / _CONFIG).exists()

    def is_for(self, config: DatasetConfig) -> bool:
        """Return whether the stopped build had this configuration and these versions."""
        try:
            return (self.building / _CONFIG).read_text(encoding="utf-8") == _content(config)
        except FileNotFoundError:
            return False

    def commit(self, manifest: Manifest) -> None:
        """Write the manifest, and move the shards of a local dataset into their final place.

        Raises:
            DatasetError: A shard is missing, or another run has taken the folder over.
        """
        there = {path.name for path in self.shards.glob("*.parquet")}
        missing = [shard.path for shard in manifest.shards if shard.path not in there]
        if missing:
            raise DatasetError(
                f"{self.shards} has no {missing[0]}, though a worker has made it: "
                "all workers have to see the same data_dir"
            )
        if not self.is_for(manifest.config):
            raise DatasetError(f"another run has begun another dataset in {self.building}")
        self.refuse_others_files()  # They may have come meanwhile.
        if isinstance(self.folder, Path) and isinstance(self.shards, Path):
            manifest.write(self.shards)
            wait_for_disk(self.shards)
            move_into_place(self.shards, self.folder)
        else:
            manifest.write(self.folder)
        self.clear()

    def abandon(self) -> bool:
        """Remove what a failed build left, unless a shard is finished; return whether it did."""
        if isinstance(self.folder, RemotePath) or any(self.building.glob("*-of-*.json")):
            return False
        self.clear()
        return True

    def clear(self) -> None:
        """Remove all that is not the finished dataset."""
        if isinstance(self.building, Path):
            # A worker of a killed run may still write there.
            shutil.rmtree(self.building, ignore_errors=True)
        else:
            # The configuration goes last, since it says what the other files belong to.
            for path in sorted(self.building.iterdir(), key=lambda path: path.name == _CONFIG):
                path.unlink(missing_ok=True)


def _content(config: DatasetConfig) -> str:
    return json.dumps({"config": config.to_json(), "versions": current_versions()})


def _may_be_ours(name: str) -> bool:
    """Return whether a file in the folder of a dataset may be the dataset's, by its name."""
    if name in (MANIFEST, TABLE, COUNTS, ANALYSIS):
        return True
    return any(form.fullmatch(name) for form in (_SHARD, _UNFINISHED))

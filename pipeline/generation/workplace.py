"""Where a dataset is built, and how it becomes whole in one moment."""

from __future__ import annotations

import json
import os
import shutil
import sys
from dataclasses import dataclass
from pathlib import Path

from labyrinth_core.data.dataset_config import DatasetConfig
from labyrinth_core.data.errors import DatasetError
from labyrinth_core.data.manifest import MANIFEST, Manifest, current_versions
from labyrinth_core.data.storage import AnyPath, RemotePath, write_text

_CONFIG = "config.json"


@dataclass(frozen=True)
class Workplace:
    """Of one dataset: its shards are made in one place, their sidecars in another."""

    folder: AnyPath
    """Where the finished dataset lies, or will."""

    @property
    def building(self) -> AnyPath:
        """Where the configuration lies, and the sidecar of each finished shard."""
        return self.folder.parent / f".{self.folder.name}.building"

    @property
    def shards(self) -> AnyPath:
        """Where the shards are made; in an object store they cannot be moved afterwards."""
        return self.folder if isinstance(self.folder, RemotePath) else self.building / "shards"

    def recover(self) -> None:
        """Put right what a crash between the renames of `commit` has left."""
        if isinstance(self.folder, Path):
            replaced = _replaced(self.folder)
            if replaced.exists() and not self.folder.exists():
                replaced.replace(self.folder)
            shutil.rmtree(replaced, ignore_errors=True)

    def prepare(self, config: DatasetConfig) -> None:
        """Make the place, emptied of what another configuration or version left in it."""
        if isinstance(self.folder, RemotePath):  # Its manifest would be over other shards.
            (self.folder / MANIFEST).unlink(missing_ok=True)
        if not self.is_for(config):
            self.clear()
            for path in self.shards.glob("*.parquet"):
                path.unlink()
        self.shards.mkdir(parents=True, exist_ok=True)
        if isinstance(self.shards, Path):
            for path in self.shards.glob(".*.tmp"):  # A run was killed while it wrote the manifest.
                path.unlink()
        if not self.is_for(config):
            write_text(self.building / _CONFIG, _content(config))

    @property
    def has_begun(self) -> bool:
        """Whether a build was stopped here."""
        return (self.building / _CONFIG).exists()

    def is_for(self, config: DatasetConfig) -> bool:
        """Return whether what is there was made for a configuration, by these versions."""
        try:
            return (self.building / _CONFIG).read_text(encoding="utf-8") == _content(config)
        except FileNotFoundError:
            return False

    def commit(self, manifest: Manifest) -> None:
        """Make the shards a dataset.

        Raises:
            DatasetError: They are not there, or not ours any more.
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
        if isinstance(self.folder, Path) and isinstance(self.shards, Path):
            manifest.write(self.shards)
            for path in [*self.shards.iterdir(), self.shards]:
                _wait_for_disk(path)
            _move_into_place(self.shards, self.folder)
            _wait_for_disk(self.folder.parent)
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
            # A worker of a killed run may be at work in it to the last.
            shutil.rmtree(self.building, ignore_errors=True)
        else:
            # The configuration last: without it nobody would know whose the rest is.
            for path in sorted(self.building.iterdir(), key=lambda path: path.name == _CONFIG):
                path.unlink(missing_ok=True)


def _content(config: DatasetConfig) -> str:
    return json.dumps({"config": config.to_json(), "versions": current_versions()})


def _wait_for_disk(path: Path) -> None:
    """Return when a file or folder would be there after the power has failed, too."""
    if sys.platform == "win32":
        return  # It opens no folders.
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    except OSError:
        if not path.is_dir():  # Not every file system can do it for those.
            raise
    finally:
        os.close(descriptor)


def _replaced(folder: Path) -> Path:
    return folder.with_name(f".{folder.name}.replaced")


def _move_into_place(shards: Path, folder: Path) -> None:
    if folder.exists():
        replaced = _replaced(folder)
        shutil.rmtree(replaced, ignore_errors=True)
        folder.replace(replaced)
        shards.replace(folder)
        shutil.rmtree(replaced)
    else:
        shards.replace(folder)

"""The folders in which a dataset is built, and the commit that puts it in place, complete."""

from __future__ import annotations

import json
import re
from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from labyrinth_core.data import SPLITS, Dataset, DatasetConfig, Manifest
from labyrinth_core.errors import DatasetError
from labyrinth_core.folders import WholeFolder
from labyrinth_core.listing import is_litter
from labyrinth_core.storage import (
    AnyPath,
    File,
)
from pipeline.machinery import Ownership, Sums, within

_CONFIG = "config.json"
_SHARD = re.compile(rf"({'|'.join(SPLITS)})-\d{{5,}}-of-\d{{5,}}\.parquet", re.ASCII)


@dataclass(frozen=True)
class Workplace:
    """The folders of one dataset: one for its shards, one for their sidecars."""

    folder: AnyPath
    """The folder of the finished dataset."""

    @classmethod
    def of(cls, folder: AnyPath) -> Workplace:
        """Return the workplace of a folder; for a link, it lies beside the link's target."""
        return cls(WholeFolder.of(folder, Manifest.FILE).folder)

    @property
    def building(self) -> AnyPath:
        """The folder of the configuration and of the sidecars of finished shards."""
        return within(self.folder.parent, f".{self.folder.name}.building")

    @property
    def shards(self) -> AnyPath:
        """The folder in which shards are made; in a store, which cannot rename, the final one."""
        return self._whole.making(within(self.building, "shards"))

    @cached_property
    def _whole(self) -> WholeFolder:
        return WholeFolder.of(self.folder, Manifest.FILE)

    def recover(self) -> None:
        """Put the old dataset back if a crash in `commit` displaced it."""
        self._whole.recover()

    def refuse_others_files(self) -> None:
        """Raise DatasetError if the final folder holds a file that our records do not list."""
        if not self.folder.exists():
            return
        if not self.folder.is_dir():
            raise DatasetError(f"{self.folder} is a file: move it, or choose another data_dir")
        recorded = self._recorded()
        others = [
            path
            for path in self.folder.iterdir()
            # A link to a folder is removed without what it leads to.
            if path.name not in recorded or (path.is_dir() and not path.is_symlink())
        ]
        _refuse(self.folder, others)

    def _recorded(self) -> set[str]:
        """Return the names in the folder that our records list.

        The manifest lists the files of the dataset, SHA256SUMS those that stages left beside them.
        In a store, once a build has begun, all shards are the build's own: it would not have begun
        beside other files. Beside a damaged manifest, which only `overwrite=true` replaces, all
        files with the names of a dataset's files count as listed.
        """
        own = Sums.read(self.folder, overwrite=True)
        names = {path.name for path in Ownership(own).unfinished([Manifest.ANALYSIS, Sums.FILE])}
        names |= {name for name, _ in own.hashes if own.has(name)} | {Sums.FILE}
        all_shards = not self._whole.is_replaced_at_once and self.has_begun
        try:
            manifest = Dataset.at(self.folder, renamed=True).manifest
            names |= {Manifest.FILE, Manifest.TABLE, *(shard.path for shard in manifest.shards)}
        except DatasetError:
            if (self.folder / Manifest.FILE).is_file():
                names.add(Manifest.FILE)
                all_shards = True
        if all_shards:
            present = {path.name for path in self.folder.iterdir()}
            names |= {name for name in present if _SHARD.fullmatch(name) or name == Manifest.TABLE}
        return names

    def lacks(self, manifest: Manifest) -> list[str]:
        """Return the files of the finished dataset that are missing or damaged.

        Files are hashed. In a store, where hashing means a download, only files newer than the
        manifest are, because the manifest is written last.
        """
        files = [(shard.path, shard.bytes, shard.sha256) for shard in manifest.shards]
        files.append((Manifest.TABLE, manifest.table.bytes, manifest.table.sha256))
        return [name for name, size, digest in files if not self._is_whole(name, size, digest)]

    def _is_whole(self, name: str, size: int, sha256: str) -> bool:
        path = self.folder / name
        with suppress(FileNotFoundError):
            actual_size, changed = File(path).size_and_time()
            is_older = self._whole.is_covered(changed)
            return actual_size == size and (is_older or File(path).sha256() == sha256)
        return False

    def prepare(
        self, config: DatasetConfig, *, parts: int | None = None, overwrite: bool = False
    ) -> None:
        """Create the folders, and remove what another configuration or version left in them.

        Args:
            config: The configuration of the dataset.
            parts: The number of parts that are being made; None to finish the dataset.
            overwrite: Whether to remove parts of another configuration, or to change their number.

        Raises:
            DatasetError: A user's files, or parts of another configuration, would be lost.
        """
        same = self.is_for(config)
        if self.parts is not None and not (same and parts in (None, self.parts)) and not overwrite:
            self._refuse_another(config, parts)
        if not self._whole.is_replaced_at_once:
            if not same:  # From now on, shards in the folder are this build's.
                self._write({"parts": None})
            (self.folder / Manifest.FILE).unlink(
                missing_ok=True
            )  # It does not describe the new shards.
            for name in [] if same else sorted(self._recorded(), key=Sums.FILE.__eq__):
                (self.folder / name).unlink(missing_ok=True)
        if not same:
            self.clear()
            self.begin(config)
        if parts is not None and parts != self.parts:
            self._write(_content(config, parts))
        self.shards.mkdir(parents=True, exist_ok=True)
        for path in self._whole.leftovers(self.shards, [Manifest.FILE]):
            path.unlink()

    def begin(self, config: DatasetConfig) -> None:
        """Record what is built, unless a build has begun; raise DatasetError as `prepare` does."""
        if self.has_begun:
            return
        self.building.mkdir(parents=True, exist_ok=True)
        if self._whole.is_replaced_at_once:  # In a store, other parts may have begun meanwhile.
            unfinished = self._whole.leftovers(self.building, [_CONFIG])
            others = [path for path in self.building.iterdir() if path not in unfinished]
            _refuse(self.building, others)
        self._write(_content(config))

    def tidy(self, names: Collection[str]) -> None:
        """Remove what killed processes left of files in `building`; no other process makes them."""
        for unfinished in self._whole.leftovers(self.building, names):
            File(unfinished).remove()

    def _write(self, content: Mapping[str, Any]) -> None:
        File(self.building / _CONFIG).write_text(json.dumps(content))

    def _refuse_another(self, config: DatasetConfig, parts: int | None) -> None:
        """Raise a DatasetError that names the differences from the build that has begun."""
        differing = Sums.differences(self._begun(), _content(config, parts or self.parts))
        cure = "overwrite=true without part to start again"
        if parts is not None and self.is_for(config):
            cure = f"overwrite=true to go on in {parts} parts"
        raise DatasetError(
            f"{self.building} holds parts of a build with {differing}: give the same options, "
            f"choose another data_dir, or give {cure}"
        )

    @property
    def has_begun(self) -> bool:
        """Whether an unfinished build is here."""
        return bool(self._begun())

    @property
    def parts(self) -> int | None:
        """The number of parts of the unfinished build, None if it is not made in parts."""
        parts = self._begun().get("parts")
        return parts if isinstance(parts, int) else None

    def is_for(self, config: DatasetConfig) -> bool:
        """Return whether the unfinished build has this configuration and these versions."""
        return self._begun() | {"parts": None} == _content(config)

    def _begun(self) -> dict[str, Any]:
        """Return the record of the unfinished build; an empty dictionary if no build has begun."""
        content = None
        with suppress(FileNotFoundError, ValueError, RecursionError):
            content = json.loads((self.building / _CONFIG).read_bytes())
        return content if isinstance(content, dict) and "parts" in content else {}

    def commit(self, manifest: Manifest) -> None:
        """Write the manifest, and move the shards of a local dataset into their final place.

        Raises:
            DatasetError: A shard is missing, or another run has taken the folder over.
        """
        made = {path.name for path in self.shards.glob("*.parquet")}
        missing = [shard.path for shard in manifest.shards if shard.path not in made]
        if missing:
            raise DatasetError(
                f"{self.shards} has no {missing[0]}, though a worker has made it: "
                "all workers must share the same data_dir"
            )
        if not self.is_for(manifest.config):
            raise DatasetError(f"another run has begun another dataset in {self.building}")
        self.refuse_others_files()  # A user may have added some since.
        manifest.write(self.shards)
        self._whole.complete(self.shards)
        self.clear()

    def abandon(self) -> bool:
        """Remove a failed build unless another run can use it; return whether it was removed."""
        finished = ("*.shard", "*.chunk")
        if not self._whole.is_replaced_at_once or self.parts is not None:
            return False
        if any(map(any, map(self.building.glob, finished))):
            return False
        self.clear()
        return True

    def clear(self) -> None:
        """Remove the unfinished build, if any; a folder with a user's files stays."""
        if self.has_begun:
            # The configuration goes last, since it says what the other files belong to.
            paths: list[AnyPath] = [*self.building.iterdir()]
            for path in sorted(paths, key=lambda path: path.name == _CONFIG):
                File(path).remove()
        with suppress(OSError):  # It is missing, or holds files of a user.
            self.building.rmdir()


def _content(config: DatasetConfig, parts: int | None = None) -> dict[str, Any]:
    """Return everything that determines the shards of a build, and the number of its parts."""
    return {**config.to_json(), **Manifest.current_versions(), "parts": parts}


def _refuse(folder: AnyPath, others: Sequence[AnyPath]) -> None:
    """Raise DatasetError if any of `others`, which are not ours, is a user's file."""
    if names := sorted(path.name for path in others if not is_litter(path.name)):
        more = f" and {len(names) - 3} more" if len(names) > 3 else ""
        raise DatasetError(
            f"{folder} holds {', '.join(names[:3])}{more}, which would be lost and does not belong "
            "to a dataset: move it elsewhere, or choose another data_dir"
        )

"""Companions: configs that stages write beside a dataset, about its labyrinths.

A companion of `5x5` lies in a folder of its own, such as `5x5-questions`, with a manifest in the
format of a dataset's. Each of its shards is about the dataset's shard of the same name, and has
that shard's fingerprint. The wing that writes a companion declares it as the `COMPANION`
of its module `companion`; card, release and validation learn of it here.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from importlib import import_module
from pathlib import Path

from labyrinth_core.data import Columns, Dataset, DatasetConfig, Manifest, Shard
from labyrinth_core.storage import AnyPath


@dataclass(frozen=True)
class Companion:
    """The declaration of a kind of companion."""

    suffix: str
    """What follows the name of the dataset's config, such as `questions`."""
    columns: Columns
    splits: Callable[[DatasetConfig], tuple[str, ...]]
    """Returns the splits of a dataset that the companion is about."""
    row: str
    """What a row stands for, for Croissant."""
    problems: Callable[[Dataset, Dataset, int], list[str]]
    """Returns what is wrong with a companion, one line for each problem, given the dataset, the
    companion, and the number of processes."""
    section: Callable[[Mapping[str, Manifest], str, str | None], str]
    """Returns the card's section on the companions, given their manifests by config, the name of
    the dataset on the Hub, and the version of the release."""
    files: Callable[[Mapping[str, Manifest], str], dict[str, bytes]]
    """Returns files for the folder of the datasets, given the companions' manifests by config and
    the dataset's title."""
    file_names: tuple[str, ...] = ()
    """The names of those files, of which some may be left out."""

    def config(self, dataset: str) -> str:
        """Return the config name of the companion of a dataset, here and on the Hub."""
        return f"{dataset}-{self.suffix}"

    def shards(self, manifest: Manifest, config: DatasetConfig) -> list[Shard]:
        """Return the shards of a dataset that a companion with a config is about."""
        splits = self.splits(config)
        return [shard for shard in manifest.shards if shard.split in splits]

    def of(self, data_dir: AnyPath, manifest: Manifest) -> Dataset | None:
        """Return the companion of a dataset; None if missing or about other rows.

        The companion lacks shifts that the dataset got after it.
        """
        folder = data_dir / self.config(manifest.config.name)
        if not (folder / Manifest.FILE).is_file():
            return None
        companion = Dataset.at(folder, companion=self.suffix)
        config, rows = companion.manifest.config, self.shards(manifest, companion.manifest.config)
        same = [(shard.path, shard.fingerprint) for shard in companion.manifest.shards] == [
            (shard.path, shard.fingerprint) for shard in rows
        ]
        return (
            companion if same and config == replace(manifest.config, shifts=config.shifts) else None
        )

    def beside(self, manifests: Sequence[Manifest]) -> dict[str, Manifest]:
        """Return the manifests of the companions of datasets, by the names of their configs."""
        return {
            self.config(manifest.config.name): manifest.companions[self.suffix]
            for manifest in manifests
            if self.suffix in manifest.companions
        }

    @staticmethod
    @cache
    def kinds() -> tuple[Companion, ...]:
        """Return the declared kinds of companions."""
        folder = Path(__file__).parents[1]
        wings = sorted(path.parent.name for path in folder.glob("*/companion.py"))
        return tuple(import_module(f"pipeline.{wing}.companion").COMPANION for wing in wings)

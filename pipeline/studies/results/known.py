"""The dataset that results are compared with, where it is at hand."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from labyrinth_core.data.errors import DatasetError
from labyrinth_core.data.labyrinth_table import TABLE, table_rows
from labyrinth_core.data.manifest import MANIFEST, Manifest
from labyrinth_core.data.source import locate
from pipeline.config.errors import ConfigError
from pipeline.config.run import Run


@dataclass(frozen=True, eq=False)
class KnownSplit:
    """The labyrinths of a split, in the order of the dataset."""

    labyrinth_ids: list[str]
    distance: list[int]
    """The number of moves on a shortest route of each."""


@dataclass(frozen=True, eq=False)
class KnownDataset:
    """What is known of a config of a dataset."""

    place: str
    """Folder, or id on the Hub, and the config."""
    fingerprint: str
    splits: Mapping[str, KnownSplit]


class AtHand:
    """The dataset that a run names, each config read once when it is first asked for."""

    def __init__(self, run: Run) -> None:
        self._run = run
        self._found: dict[str, KnownDataset | None] = {}
        self.missing: dict[str, str] = {}
        """Config that was asked for -> why it is not at hand."""

    def __call__(self, config: str) -> KnownDataset | None:
        """Return what is known of a config such as `5x5`, None if it is not at hand.

        Raises:
            ConfigError: A folder is given with a revision.
        """
        if config not in self._found:
            self._found[config] = None
            try:
                self._found[config] = self._read(config)
            except DatasetError as error:
                self.missing[config] = str(error)
            except ValueError as error:
                raise ConfigError(str(error)) from error
        return self._found[config]

    def _read(self, config: str) -> KnownDataset:
        run = self._run
        if run.options.dataset is None and not (run.data_dir / config / MANIFEST).is_file():
            raise DatasetError(f"{run.data_dir / config} holds no dataset")  # Not asking the Hub.
        folder = locate(run.source, config, [TABLE], run.options.revision)
        manifest = Manifest.read(folder)
        splits: dict[str, KnownSplit] = {}
        for row in table_rows(folder, manifest):
            split = splits.setdefault(row["split"], KnownSplit([], []))
            split.labyrinth_ids.append(row["labyrinth_id"])
            split.distance.append(row["moves"])
        return KnownDataset(f"{run.source}/{config}", manifest.fingerprint, splits)

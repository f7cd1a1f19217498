"""The numbers of a dataset that its card shows: its counts, and how near its splits are.

How near they are is in the file that the stage `analyse` has left, if it has.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

from labyrinth_core.data.errors import DatasetError
from labyrinth_core.data.manifest import ANALYSIS, Manifest
from labyrinth_core.data.storage import AnyPath
from pipeline.machinery.counts import DatasetCounts, SplitCounts


class Closeness(NamedTuple):
    """How many labyrinths of a split have what counterpart in another."""

    first: str
    second: str
    of: int
    """The number of labyrinths of the second split."""
    symmetric: int
    """Those of which a rotation or reflection is in the first split."""
    within: tuple[int, ...]
    """Those with one in the first split that is at most 1, 2 and 3 walls away."""
    same_route: int
    """Those of which an optimal route is optimal in a labyrinth of the first split."""
    nearest: str
    """Walls to the nearest in the first split, least and median."""


@dataclass(frozen=True, eq=False)
class DatasetStatistics:
    """The numbers of one dataset, one config of a folder."""

    manifest: Manifest
    counts: DatasetCounts
    closeness: tuple[Closeness, ...]
    """One for each pair of splits; empty if the stage `analyse` has not looked at these rows."""

    @property
    def name(self) -> str:
        """The name of its config."""
        return self.manifest.config.name

    @property
    def splits(self) -> Mapping[str, SplitCounts]:
        """The counts of each split, in the order of the table of splits."""
        return self.counts.splits

    @property
    def rows(self) -> int:
        """The number of rows of all splits."""
        return sum(counts.rows for counts in self.splits.values())


def read_closeness(folder: AnyPath, manifest: Manifest) -> tuple[Closeness, ...]:
    """Return what the stage `analyse` has found out about a dataset, if it has.

    Args:
        folder: The folder of the dataset.
        manifest: Its manifest; what was found out about other rows is left alone.

    Raises:
        DatasetError: The file is damaged.
    """
    path = folder / ANALYSIS
    try:
        content = json.loads(path.read_bytes())
        if content["fingerprint"] != manifest.fingerprint:
            return ()
        leakage = content["leakage"]
        return tuple(
            Closeness(
                str(pair["first"]),
                str(pair["second"]),
                int(leakage["labyrinths"][pair["second"]]),
                len(pair["symmetric"]),
                tuple(int(pair["within"][walls]) for walls in ("1", "2", "3")),
                len(pair["same_route"]),
                str(pair["spread"]),
            )
            for pair in leakage["pairs"]
        )
    except FileNotFoundError:
        return ()
    except (ValueError, LookupError, TypeError, AttributeError) as error:
        raise DatasetError(f"{path} cannot be read: stages=[analyse] writes it anew") from error

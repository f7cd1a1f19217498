"""Datasets on disk or on the Hub: their format, and reading them as arrays, episodes and streams.

`Dataset` finds a dataset, checks each file before it is used, and gives rows by its selections.
Each name is imported on first use.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:  # `as` marks a name as public for type checkers.
    from labyrinth_core.data.dataset import ShardFile as ShardFile
    from labyrinth_core.data.dataset_config import DatasetConfig as DatasetConfig
    from labyrinth_core.data.datasets import Dataset as Dataset
    from labyrinth_core.data.datasets import Selection as Selection
    from labyrinth_core.data.drawing import Drawing as Drawing
    from labyrinth_core.data.episodes import LoadedEpisode as LoadedEpisode
    from labyrinth_core.data.format import COLUMNS as COLUMNS
    from labyrinth_core.data.format import TABLE_COLUMNS as TABLE_COLUMNS
    from labyrinth_core.data.format import Columns as Columns
    from labyrinth_core.data.manifest import Manifest as Manifest
    from labyrinth_core.data.manifest import Shard as Shard
    from labyrinth_core.data.splits import SPLITS as SPLITS

_HOMES = {
    "COLUMNS": "format",
    "SPLITS": "splits",
    "TABLE_COLUMNS": "format",
    "Columns": "format",
    "Dataset": "datasets",
    "DatasetConfig": "dataset_config",
    "Drawing": "drawing",
    "LoadedEpisode": "episodes",
    "Manifest": "manifest",
    "Selection": "datasets",
    "Shard": "manifest",
    "ShardFile": "dataset",
}
"""Name -> the module of this room that defines it."""

__all__ = [*_HOMES]


def __getattr__(name: str) -> Any:
    """Import the module of a name of this room, and return the object (PEP 562)."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
    globals()[name] = value
    return value

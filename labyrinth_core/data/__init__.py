"""Datasets on disk or on the Hub: their format, and reading them as arrays, episodes and streams.

`Dataset` finds a dataset, checks each file before it is used, and gives rows by its selections.
Each name is imported on first use.
"""

from typing import TYPE_CHECKING

from labyrinth_core.doors import door

if TYPE_CHECKING:  # `as` marks a name as public for type checkers.
    from labyrinth_core.data.dataset_config import SPLITS as SPLITS
    from labyrinth_core.data.dataset_config import DatasetConfig as DatasetConfig
    from labyrinth_core.data.datasets import Dataset as Dataset
    from labyrinth_core.data.datasets import Selection as Selection
    from labyrinth_core.data.drawing import Drawing as Drawing
    from labyrinth_core.data.format import COLUMNS as COLUMNS
    from labyrinth_core.data.format import TABLE_COLUMNS as TABLE_COLUMNS
    from labyrinth_core.data.format import Columns as Columns
    from labyrinth_core.data.load import LoadedEpisode as LoadedEpisode
    from labyrinth_core.data.manifest import Manifest as Manifest
    from labyrinth_core.data.manifest import Shard as Shard
    from labyrinth_core.data.rows import ShardFile as ShardFile
else:
    __getattr__, __dir__ = door(
        __name__,
        {
            "dataset_config": (
                "SPLITS",
                "DatasetConfig",
            ),
            "datasets": (
                "Dataset",
                "Selection",
            ),
            "drawing": ("Drawing",),
            "format": (
                "COLUMNS",
                "TABLE_COLUMNS",
                "Columns",
            ),
            "load": ("LoadedEpisode",),
            "manifest": (
                "Manifest",
                "Shard",
            ),
            "rows": ("ShardFile",),
        },
    )

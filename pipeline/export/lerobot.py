"""Export as LeRobot datasets of version 3.0, written in the layout that the library documents.

The library itself cannot be installed with ours, because it needs older versions of torch and
`datasets`. Layout, columns and types are those of `lerobot.datasets.lerobot_dataset` and
`lerobot.datasets.utils` of https://pypi.org/project/lerobot/, 0.4.4; see also
https://huggingface.co/docs/lerobot/lerobot-dataset-v3.

Each state is a frame, including the last one of an episode, which has action -1 and reward 0.
Pictures are PNG files within Parquet; there is no video.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from itertools import chain, repeat
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.data import TABLE_COLUMNS, LoadedEpisode
from labyrinth_core.errors import DatasetError
from labyrinth_core.storage import File
from pipeline.config import ExportOptions
from pipeline.export.stage import PART_BYTES, Split, in_parts, png_value

if TYPE_CHECKING:
    import pyarrow as pa

IMAGE = "observation.image"
EPISODES = "meta/episodes/chunk-000/file-000.parquet"
DATA = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"

FPS = 10
"""Frames per second, which the format requires; the environment renders at the same rate."""

CHUNK_FILES, FILE_MB, VIDEO_MB = 1000, 100, 200
"""LeRobot's defaults: files per folder, and the maximum megabytes of a data and a video file."""


def write(split: Split, folder: Path, part_bytes: int = PART_BYTES) -> None:
    """Write a split into an empty folder.

    Raises:
        DatasetError: The table of labyrinths does not match the episodes.
    """
    import datasets
    import pandas as pd
    import pyarrow as pa
    import pyarrow.parquet as pq

    sums: dict[str, Sums] = {}
    scalars = {name: datasets.Value(dtype) for name, dtype in _SCALARS.items()}
    schema = datasets.Features({IMAGE: datasets.Image(), **scalars}).arrow_schema
    (folder / EPISODES).parent.mkdir(parents=True)
    with pq.ParquetWriter(folder / EPISODES, _episode_schema()) as episodes:
        parts = in_parts(_frames_and_rows(split, sums), part_bytes)
        for number, part in enumerate(parts):
            chunk, file = divmod(number, CHUNK_FILES)
            path = folder / DATA.format(chunk_index=chunk, file_index=file)
            path.parent.mkdir(parents=True, exist_ok=True)
            with pq.ParquetWriter(path, schema) as frames:
                frames.write_table(_joined([each for each, _ in part], schema))
            place = {"data/chunk_index": chunk, "data/file_index": file}
            rows = [row | place for _, row in part]
            episodes.write_table(pa.Table.from_pylist(rows, episodes.schema))
    task = str(split.manifest.config.task)
    pd.DataFrame({"task_index": [0]}, index=[task]).to_parquet(folder / "meta/tasks.parquet")
    File(folder / "meta/stats.json").write_text(json.dumps(_statistics(sums), indent=4))
    File(folder / "meta/info.json").write_text(json.dumps(_info(split), indent=4))


def _frames_and_rows(
    split: Split, sums: dict[str, Sums]
) -> Iterator[tuple[int, tuple[dict[str, Any], dict[str, Any]]]]:
    """Yield, for each episode, the bytes of its pictures, and its frames with its row in the table.

    Each episode is also added to `sums`.
    """
    first = 0
    task = str(split.manifest.config.task)
    labyrinths = chain(_labyrinths(split), repeat({"labyrinth_id": ""}))  # The table may be short.
    pairs = zip(split.episodes(), labyrinths, strict=False)
    for number, (episode, labyrinth) in enumerate(pairs):
        if labyrinth["labyrinth_id"] != f"{episode.labyrinth_id:016x}":
            raise DatasetError(
                f"split={split.name}: the table of labyrinths does not match its episodes"
            )
        frames = _frames(episode, number, first)
        own = {name: _sums(each) for name, each in (frames | {IMAGE: episode.observations}).items()}
        for name, each in own.items():
            sums[name] = _added(sums[name], each) if name in sums else each
        frames[IMAGE] = [png_value(picture) for picture in episode.observations]
        row = {
            "episode_index": number,
            "tasks": [task],
            "length": len(episode) + 1,
            "dataset_from_index": first,
            "dataset_to_index": first + len(episode) + 1,
            "meta/episodes/chunk_index": 0,
            "meta/episodes/file_index": 0,
            "info": episode.info,
            **labyrinth,
            **{
                f"stats/{name}/{key}": value
                for name, found in _statistics(own).items()
                for key, value in found.items()
            },
        }
        yield sum(len(picture["bytes"]) for picture in frames[IMAGE]), (frames, row)
        first += len(episode) + 1


def _labyrinths(split: Split) -> Iterator[dict[str, Any]]:
    """Yield, for each episode, the row of its labyrinth in the table of labyrinths."""
    for group in split.data.table_groups():
        for row in group.to_pylist():
            if row["split"] == split.name:
                yield from repeat(row, row["episodes"])


def _frames(episode: LoadedEpisode, number: int, first: int) -> dict[str, Any]:
    """Return the columns of an episode's frames, except the pictures.

    Args:
        episode: The episode.
        number: The index of the episode.
        first: The index of its first frame in the dataset.
    """
    steps = np.arange(len(episode) + 1)
    done = steps >= len(episode) - 1
    return {
        "action": episode.actions_of_states,
        "next.reward": np.append(episode.rewards, np.float32(0)),
        "next.done": done,
        "next.truncated": done & episode.truncated,
        "timestamp": (steps / FPS).astype(np.float32),
        "frame_index": steps,
        "episode_index": np.full(len(steps), number),
        "index": first + steps,
        "task_index": np.zeros(len(steps), np.int64),
    }


def _joined(frames: list[dict[str, Any]], schema: pa.Schema) -> pa.Table:
    """Return the frames of several episodes as one table."""
    import pyarrow as pa

    pictures = [picture for each in frames for picture in each[IMAGE]]
    columns = {
        name: pictures if name == IMAGE else np.concatenate([each[name] for each in frames])
        for name in schema.names
    }
    return pa.table(columns, schema)


def _info(split: Split) -> dict[str, Any]:
    """Return LeRobot's metadata of a dataset: its counts, files, and the columns of its frames."""
    size = split.image_size
    picture = {
        "dtype": "image",
        "shape": [size, size, 3],
        "names": ["height", "width", "channels"],
    }
    scalars = {
        name: {"dtype": kind, "shape": [1], "names": None} for name, kind in _SCALARS.items()
    }
    return {
        "codebase_version": ExportOptions.CODEBASE_VERSION,
        "robot_type": None,
        "total_episodes": split.count,
        "total_frames": split.rows,
        "total_tasks": 1,
        "chunks_size": CHUNK_FILES,
        "data_files_size_in_mb": FILE_MB,
        "video_files_size_in_mb": VIDEO_MB,
        "fps": FPS,
        "splits": {"train": f"0:{split.count}"},
        "data_path": DATA,
        "video_path": None,
        "features": {IMAGE: picture, **scalars},
    }


_SCALARS = {
    "action": "int64",
    "next.reward": "float32",
    "next.done": "bool",
    "next.truncated": "bool",
    "timestamp": "float32",
    "frame_index": "int64",
    "episode_index": "int64",
    "index": "int64",
    "task_index": "int64",
}
"""Column of the frames -> its type, except the pictures."""


def _episode_schema() -> pa.Schema:
    """Return the Arrow schema of the table of episodes, including our table's columns.

    LeRobot appends episodes in files of their own, with statistics and without our columns; it can
    read all files together only if the first one has all columns.
    """
    import pyarrow as pa

    fields: list[tuple[str, Any]] = [
        ("episode_index", pa.int64()),
        ("tasks", pa.list_(pa.string())),
        ("length", pa.int64()),
        ("data/chunk_index", pa.int64()),
        ("data/file_index", pa.int64()),
        ("dataset_from_index", pa.int64()),
        ("dataset_to_index", pa.int64()),
        ("meta/episodes/chunk_index", pa.int64()),
        ("meta/episodes/file_index", pa.int64()),
        ("info", pa.string()),
    ]
    fields += [(each.name, pa.type_for_alias(each.feature["dtype"])) for each in TABLE_COLUMNS]
    number = pa.list_(pa.float64())
    for name, type_ in {
        **dict.fromkeys(_SCALARS, number),
        IMAGE: pa.list_(pa.list_(number)),
    }.items():
        fields += [(f"stats/{name}/{key}", type_) for key in STATISTICS]
        fields.append((f"stats/{name}/count", pa.list_(pa.int64())))
    return pa.schema(fields)


Sums = NDArray[np.float64]
"""For a column with C channels, shape (11, C): numbers of frames and of values, the sums of values
and of squares, for each of `PERCENTS` the quantile times the frames, the minimum, the maximum."""

PERCENTS = (1, 10, 50, 90, 99)

STATISTICS = ("min", "max", "mean", "std", *(f"q{percent:02d}" for percent in PERCENTS))
"""The statistics with which LeRobot's policies normalise their inputs, except the number of frames.

They are computed as in `lerobot.datasets.compute_stats`, but from all frames instead of a sample;
for pictures per channel, with brightness from 0 to 1. The standard deviation has ddof 0. As there,
a quantile of several episodes is the mean of their quantiles, weighted by their frames.
"""


def _sums(column: NDArray[Any]) -> Sums:
    """Return the sums of N frames: pictures uint8 (N, height, width, 3), or numbers (N,)."""
    levels, counts = _counted(column)
    occurs, values, below = counts > 0, counts.sum(1), counts.cumsum(1)
    quantiles = [
        len(column) * levels[(100 * below >= percent * values[:, None]).argmax(1)]
        for percent in PERCENTS
    ]
    return np.array(
        [
            np.full(len(counts), len(column)),
            values,
            counts @ levels,
            counts @ levels**2,
            *quantiles,
            levels[occurs.argmax(1)],
            levels[::-1][occurs[:, ::-1].argmax(1)],
        ]
    )


def _added(one: Sums, other: Sums) -> Sums:
    """Return the combined sums."""
    least, largest = np.minimum(one[-2], other[-2]), np.maximum(one[-1], other[-1])
    return np.array([*(one[:-2] + other[:-2]), least, largest])


def _statistics(sums: Mapping[str, Sums]) -> dict[str, dict[str, list[Any]]]:
    """Return the statistics of each column, of shape (3, 1, 1) for pictures, (1,) for numbers."""
    found = {}
    for name, (frames, count, total, squares, *quantiles, least, largest) in sums.items():
        mean = total / count
        deviation = np.sqrt(np.maximum(0, squares / count - mean**2))
        shape = (-1, 1, 1) if len(mean) > 1 else (-1,)
        values = [least, largest, mean, deviation, *(each / frames for each in quantiles)]
        pairs = zip(STATISTICS, values, strict=True)
        found[name] = {key: value.reshape(shape).tolist() for key, value in pairs}
        found[name]["count"] = [int(frames[0])]
    return found


def _counted(column: NDArray[Any]) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return the V possible values, ascending (V,), and how often each occurs, (C, V)."""
    if column.ndim == 4:
        channels = [np.bincount(column[..., each].ravel(), minlength=256) for each in range(3)]
        return np.arange(256) / 255, np.array(channels)
    values, counts = np.unique(column.astype(np.float64), return_counts=True)
    return values, counts[None]

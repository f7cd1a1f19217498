"""Statistics of the columns of a LeRobot dataset, by which its policies normalise what they see."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class FrameStatistics:
    """What was counted of each column so far.

    Least, largest and mean value, standard deviation (ddof 0) and number of frames are those of
    `lerobot.datasets.compute_stats`, but of all frames instead of some; of pictures for each
    channel, brightness from 0 to 1.
    """

    sums: dict[str, NDArray[np.float64]] = field(default_factory=dict)
    """Column -> frames, values, their sum, that of their squares, least and largest, (6, C)."""

    def add(self, columns: Mapping[str, NDArray[Any]]) -> None:
        """Count some frames: pictures uint8 (N, height, width, 3), or numbers (N,)."""
        for name, column in columns.items():
            levels, counts = _counted(column)
            occurs = counts > 0
            new = np.array(
                [
                    np.full(len(counts), len(column)),
                    counts.sum(1),
                    counts @ levels,
                    counts @ levels**2,
                    levels[occurs.argmax(1)],
                    levels[::-1][occurs[:, ::-1].argmax(1)],
                ]
            )
            if (old := self.sums.get(name)) is not None:
                new[:4] += old[:4]
                new[4], new[5] = np.minimum(old[4], new[4]), np.maximum(old[5], new[5])
            self.sums[name] = new

    def values(self) -> dict[str, dict[str, list[Any]]]:
        """Return the statistics of each column: those of pictures (3, 1, 1), of numbers (1,)."""
        found = {}
        for name, (frames, count, total, squares, least, largest) in self.sums.items():
            mean = total / count
            deviation = np.sqrt(np.maximum(0, squares / count - mean**2))
            shape = (-1, 1, 1) if len(mean) > 1 else (-1,)
            each = {"min": least, "max": largest, "mean": mean, "std": deviation}
            found[name] = {key: value.reshape(shape).tolist() for key, value in each.items()}
            found[name]["count"] = [int(frames[0])]
        return found


def _counted(column: NDArray[Any]) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return the values that there may be, ascending (V,), and how often each occurs, (C, V)."""
    if column.ndim == 4:
        channels = [np.bincount(column[..., each].ravel(), minlength=256) for each in range(3)]
        return np.arange(256) / 255, np.array(channels)
    values, counts = np.unique(column.astype(np.float64), return_counts=True)
    return values, counts[None]

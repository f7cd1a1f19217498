"""Episodes summed up by counts, so that a hundred thousand of them fit in memory."""

from __future__ import annotations

import zipfile
import zlib
from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.analysis.environments.environment import World
from pipeline.analysis.environments.frames import Frame
from pipeline.analysis.shift import Floats


@dataclass(frozen=True, eq=False)
class Summary:
    """Some episodes, by their counts and the little else that is asked of them."""

    counts: NDArray[Any]
    """Of each episode, as `Frame.counts` has them, shape (episodes, counts)."""
    means: Floats
    """Of its actions (of discrete ones, the share of each) and states, (episodes, dimensions)."""
    totals: Floats
    """Its return, shape (episodes,)."""
    steps: NDArray[np.int64]
    first: Floats
    """Its first state, shape (episodes, dimensions of the state)."""
    lowest: Floats
    """Of all states, shape (dimensions,)."""
    highest: Floats
    visits: NDArray[np.int64]
    """Maps of the episodes of even and of odd seeds, shape (2, up, across)."""

    @classmethod
    def of(cls, world: World, frame: Frame, seeds: range) -> Summary:
        """Play the episodes of some seeds, and sum them up."""
        return cls.joined([_summary(world, frame, seed) for seed in seeds])

    @classmethod
    def joined(cls, parts: Sequence[Summary]) -> Summary:
        """Return the summary of all episodes of some summaries, in their order."""
        columns = {
            field.name: [getattr(part, field.name) for part in parts] for field in fields(cls)
        }
        return cls(
            lowest=np.min(columns.pop("lowest"), axis=0),
            highest=np.max(columns.pop("highest"), axis=0),
            visits=np.sum(columns.pop("visits"), axis=0),
            **{name: np.concatenate(values) for name, values in columns.items()},
        )

    def save(self, path: Path) -> None:
        """Write it; the file is whole or not there."""
        temporary = path.with_name(f".{path.name}.tmp")
        with temporary.open("wb") as file:
            np.savez_compressed(file, **vars(self))
        temporary.replace(path)

    @classmethod
    def load(cls, path: Path) -> Summary | None:
        """Return the summary in a file, None if there is none that is whole."""
        try:
            with path.open("rb") as file, np.load(file, allow_pickle=False) as arrays:
                return cls(**arrays)
        except (OSError, ValueError, TypeError, EOFError, zipfile.BadZipFile, zlib.error):
            return None


def _summary(world: World, frame: Frame, seed: int) -> Summary:
    trajectory = world.play(seed)
    states, actions = trajectory.states, trajectory.actions
    counts = frame.counts(trajectory)
    if isinstance(frame.actions, int):
        actions = np.eye(frame.actions)[actions]
    visits = np.zeros((2, len(frame.up) - 1, len(frame.across) - 1), np.int64)
    across, up = world.place(states).T
    visits[seed % 2] = np.histogram2d(up, across, (frame.up, frame.across))[0]
    return Summary(
        # An episode has a thousand steps or so; where one has more, nothing is lost either.
        counts=counts[None].astype(np.uint16 if counts.max() < 1 << 16 else np.uint32),
        means=np.concatenate([actions.mean(axis=0), states.mean(axis=0)])[None],
        totals=np.array([trajectory.total]),
        steps=np.array([len(trajectory.actions)]),
        first=states[:1],
        lowest=states.min(axis=0),
        highest=states.max(axis=0),
        visits=visits,
    )

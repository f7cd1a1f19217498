"""Reduce episodes to counts, so that a hundred thousand episodes fit in memory."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from environments.discretisation import Discretisation
from environments.environment import Environment
from labyrinth_core.storage import File
from pipeline.inspection.shift import Floats


@dataclass(frozen=True, eq=False)
class Summary:
    """The counts of several episodes, and other statistics."""

    counts: NDArray[Any]
    """`Discretisation.counts` of each episode, shape (episodes, counts)."""
    means: Floats
    """The mean of each episode's actions (the share of each discrete one) and states, shape
    (episodes, dimensions)."""
    totals: Floats
    """The return of each episode, shape (episodes,)."""
    steps: NDArray[np.int64]
    """The number of steps of each episode, shape (episodes,)."""
    first: Floats
    """The first state of each episode, shape (episodes, dimensions of the state)."""
    lowest: Floats
    """The minimum over all states, shape (dimensions,)."""
    highest: Floats
    """The maximum over all states, shape (dimensions,)."""
    visits: NDArray[np.int64]
    """The maps of visits of even and of odd seeds, shape (2, up, across)."""

    @classmethod
    def of(cls, environment: Environment, discretisation: Discretisation, seeds: range) -> Summary:
        """Play the episodes of seeds, and summarise them."""
        return cls.joined([_summary(environment, discretisation, seed) for seed in seeds])

    @classmethod
    def joined(cls, parts: Sequence[Summary]) -> Summary:
        """Concatenate summaries in order."""
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
        """Write the summary to a file, atomically."""
        content = io.BytesIO()
        np.savez_compressed(content, **vars(self))
        File(path).write_bytes(content.getvalue())

    @classmethod
    def load(cls, path: Path) -> Summary | None:
        """Read a summary; return None if the file is missing or damaged."""
        try:
            with path.open("rb") as file, np.load(file, allow_pickle=False) as arrays:
                return cls(**arrays)
        except Exception:  # A damaged archive can raise any error.
            return None


def _summary(environment: Environment, discretisation: Discretisation, seed: int) -> Summary:
    trajectory = environment.play(seed)
    states, actions = trajectory.states, trajectory.actions
    counts = discretisation.counts(trajectory)
    if isinstance(discretisation.actions, int):
        actions = np.eye(discretisation.actions)[actions]
    edges = discretisation.up, discretisation.across
    visits = np.zeros((2, len(edges[0]) - 1, len(edges[1]) - 1), np.int64)
    across, up = environment.on_map(states).T
    visits[seed % 2] = np.histogram2d(up, across, edges)[0]
    return Summary(
        # Most episodes have about a thousand steps, but longer ones must not overflow.
        counts=counts[None].astype(np.uint16 if counts.max() < 1 << 16 else np.uint32),
        means=np.concatenate([actions.mean(axis=0), states.mean(axis=0)])[None],
        totals=np.array([trajectory.total]),
        steps=np.array([len(trajectory.actions)]),
        first=states[:1],
        lowest=states.min(axis=0),
        highest=states.max(axis=0),
        visits=visits,
    )

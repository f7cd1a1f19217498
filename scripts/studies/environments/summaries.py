"""Reduce episodes to counts at fixed points, and measure distances between counts.

For each dimension of the states and of continuous actions, an episode is reduced to the number of
values at or below each point; for discrete actions, to the number of each action. These counts are
additive: their sum over many episodes gives the pooled distribution functions at the points, and a
hundred thousand episodes fit in memory.
"""

from __future__ import annotations

import hashlib
import io
import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from environments.environment import Environment, Trajectory
from labyrinth_core.storage import File
from pipeline.inspection.shift import Floats, jensen_shannon, wasserstein_of_counts

POINTS = 32
"""The number of evenly spaced points, and of quantiles, for a continuous dimension."""
BINS = 48
"""The number of bins of a map of visits in each direction, if its values are continuous."""

_MARGIN = 0.1
"""The share of the range that is added at both ends, for episodes beyond the range."""


@dataclass(frozen=True, eq=False)
class Axes:
    """Several dimensions, each with the points at which distributions are compared."""

    points: tuple[Floats, ...]
    """In ascending order; values beyond the first or last point count as that point."""

    @classmethod
    def through(cls, values: Floats) -> Axes:
        """Return axes that cover `values`, shape (n, dimensions)."""
        return cls(tuple(_points(column) for column in values.T))

    def counts(self, values: Floats) -> NDArray[np.int64]:
        """Return the number of values at or below each point, dimension after dimension.

        A value counts as the nearest point. The error of `distances`, which takes sums for areas,
        is then little more than the square of the distance between two points.

        Args:
            values: Shape (n, dimensions).

        Returns:
            Shape (points,); at the last point of a dimension it is n.
        """
        counts = [
            [*np.searchsorted(np.sort(column), (points[1:] + points[:-1]) / 2), len(values)]
            for column, points in zip(values.T, self.points, strict=True)
        ]
        return np.concatenate(counts).astype(np.int64)

    def distances(self, counts_a: Floats, counts_b: Floats) -> Floats:
        """Return the Wasserstein distance in each dimension, in its unit.

        Args:
            counts_a: Sums of counts, shape (..., points).
            counts_b: As `counts_a`.

        Returns:
            Shape (..., dimensions).
        """
        ends = np.cumsum([len(points) for points in self.points])[:-1]
        a, b = (np.split(counts, ends, axis=-1) for counts in (counts_a, counts_b))
        parts = zip(a, b, map(np.diff, self.points), strict=True)
        return np.stack([wasserstein_of_counts(*part) for part in parts], axis=-1)


def _points(values: Floats) -> Floats:
    if (values == np.rint(values)).all():
        return np.arange(values.min(), values.max() + 1)
    margin = _MARGIN * np.ptp(values)
    even = np.linspace(values.min() - margin, values.max() + margin, POINTS)
    return np.unique([*even, *np.quantile(values, np.linspace(0, 1, POINTS))])


@dataclass(frozen=True, eq=False)
class Discretisation:
    """The points at which the values of an environment's episodes are counted."""

    actions: Axes | int
    """The number of actions if they are discrete."""
    states: Axes
    across: Floats
    """The edges of the bins of a map of visits, from left to right."""
    up: Floats
    """The edges of the bins of a map of visits, from the bottom to the top."""

    @classmethod
    def around(cls, environment: Environment, pilots: Iterable[Trajectory]) -> Discretisation:
        """Return a discretisation that covers pilot episodes, and others like them."""
        states = np.concatenate([pilot.states for pilot in pilots])
        actions: Axes | int
        if isinstance(environment.actions, int):
            actions = environment.actions
        else:
            bounds = zip(*environment.actions, strict=True)
            actions = Axes(tuple(np.linspace(low, high, 2 * POINTS + 1) for low, high in bounds))
        across, up = (_edges(values) for values in environment.on_map(states).T)
        return cls(actions, Axes.through(states), across, up)

    @property
    def fingerprint(self) -> str:
        """The SHA-256 of all points; counts at different points cannot be compared."""
        actions = () if isinstance(self.actions, int) else self.actions.points
        points = [each.tolist() for each in (*actions, *self.states.points, self.across, self.up)]
        return hashlib.sha256(json.dumps(points).encode()).hexdigest()

    def counts(self, trajectory: Trajectory) -> NDArray[np.int64]:
        """Return the counts of an episode: those of its actions, then those of its states."""
        if isinstance(self.actions, int):
            of_actions = np.bincount(trajectory.actions, minlength=self.actions)
        else:
            of_actions = self.actions.counts(trajectory.actions.astype(np.float64))
        return np.concatenate([of_actions, self.states.counts(trajectory.states)])

    def distances(self, a: Floats, b: Floats) -> tuple[Floats, Floats]:
        """Return the distances between two sums of counts, shape (..., counts).

        Returns:
            The distance of the actions, shape (...): Jensen-Shannon if they are discrete, otherwise
            the mean of the Wasserstein distances in each dimension. The distances of the states in
            each dimension, in its unit, shape (..., dimensions).
        """
        of_states = -sum(map(len, self.states.points))
        actions_a, actions_b = a[..., :of_states], b[..., :of_states]
        if isinstance(self.actions, int):
            actions = jensen_shannon(actions_a, actions_b)
        else:
            actions = self.actions.distances(actions_a, actions_b).mean(axis=-1)
        return actions, self.states.distances(a[..., of_states:], b[..., of_states:])


def _edges(values: Floats) -> Floats:
    if (values == np.rint(values)).all():
        return np.arange(values.min(), values.max() + 2) - 0.5
    return np.linspace(values.min(), values.max(), BINS + 1)


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

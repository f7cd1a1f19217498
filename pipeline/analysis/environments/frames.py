"""What the episodes of an environment are counted on, and distances from such counts.

An episode becomes, for each dimension of states and continuous actions, the number of its values
at or below each of some points, and for discrete actions the number of each. Such counts add up:
those of many episodes give their pooled distribution functions at these points.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.analysis.environments.environment import Trajectory, World
from pipeline.analysis.shift import Floats, jensen_shannon, wasserstein_of_counts

POINTS = 32
"""A dimension has that many evenly spaced points and as many quantiles, where it is continuous."""
BINS = 48
"""Of a map of visits, across and up, where its values are continuous."""

_WIDENED = 0.1
"""Share of the range that a grid adds at both ends, for episodes that go farther."""


@dataclass(frozen=True, eq=False)
class Axes:
    """Several dimensions, each with its points: where a sample's distribution is measured."""

    points: tuple[Floats, ...]
    """Ascending; values beyond the first and the last count as these."""

    @classmethod
    def through(cls, values: Floats) -> Axes:
        """Return axes for values like these, shape (n, dimensions)."""
        return cls(tuple(_points(column) for column in values.T))

    def to_json(self) -> list[list[float]]:
        """Return it in plain types; `from_json` is the inverse."""
        return [points.tolist() for points in self.points]

    @classmethod
    def from_json(cls, values: list[list[float]]) -> Axes:
        """Return the axes that `to_json` described."""
        return cls(tuple(np.array(points) for points in values))

    def counts(self, values: Floats) -> NDArray[np.int64]:
        """Return how many values are at or below each point, dimension after dimension.

        A value counts as the nearest point, so that the sums which `distances` takes for areas
        are off by little more than the square of what lies between two points.

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
            counts_a: Added up, shape (..., points).
            counts_b: As `counts_a`.

        Returns:
            Shape (..., dimensions).
        """
        ends = np.cumsum([len(points) for points in self.points])
        return np.stack(
            [
                wasserstein_of_counts(
                    counts_a[..., end - len(points) : end],
                    counts_b[..., end - len(points) : end],
                    np.diff(points),
                )
                for points, end in zip(self.points, ends, strict=True)
            ],
            axis=-1,
        )


def _points(values: Floats) -> Floats:
    if (values == np.rint(values)).all():
        return np.arange(values.min(), values.max() + 1)
    margin = _WIDENED * np.ptp(values)
    even = np.linspace(values.min() - margin, values.max() + margin, POINTS)
    return np.unique([*even, *np.quantile(values, np.linspace(0, 1, POINTS))])


@dataclass(frozen=True, eq=False)
class Frame:
    """What the episodes of an environment are measured on; the same for all of them."""

    actions: Axes | int
    """The number of actions where they are discrete."""
    states: Axes
    across: Floats
    """Edges of the bins of a map of visits."""
    up: Floats

    @classmethod
    def around(cls, world: World, pilots: Iterable[Trajectory]) -> Frame:
        """Return a frame in which some first episodes, and others like them, have room."""
        states = np.concatenate([pilot.states for pilot in pilots])
        actions: Axes | int
        if isinstance(world.actions, int):
            actions = world.actions
        else:
            bounds = zip(*world.actions, strict=True)
            actions = Axes(tuple(np.linspace(low, high, 2 * POINTS + 1) for low, high in bounds))
        across, up = (_edges(values) for values in world.place(states).T)
        return cls(actions, Axes.through(states), across, up)

    @property
    def lowest(self) -> Floats:
        """The first point of each dimension of the state."""
        return np.array([points[0] for points in self.states.points])

    @property
    def highest(self) -> Floats:
        """The last point of each dimension of the state."""
        return np.array([points[-1] for points in self.states.points])

    def to_json(self) -> dict[str, Any]:
        """Return it in plain types; `from_json` is the inverse."""
        return {
            "actions": self.actions if isinstance(self.actions, int) else self.actions.to_json(),
            "states": self.states.to_json(),
            "across": self.across.tolist(),
            "up": self.up.tolist(),
        }

    @classmethod
    def from_json(cls, values: dict[str, Any]) -> Frame:
        """Return the frame that `to_json` described."""
        actions = values["actions"]
        return cls(
            actions if isinstance(actions, int) else Axes.from_json(actions),
            Axes.from_json(values["states"]),
            np.array(values["across"]),
            np.array(values["up"]),
        )

    def counts(self, trajectory: Trajectory) -> NDArray[np.int64]:
        """Return the counts of an episode: its actions', then its states'."""
        if isinstance(self.actions, int):
            of_actions = np.bincount(trajectory.actions, minlength=self.actions)
        else:
            of_actions = self.actions.counts(trajectory.actions.astype(np.float64))
        return np.concatenate([of_actions, self.states.counts(trajectory.states)])

    def action_distance(self, a: Floats, b: Floats) -> Floats:
        """Return the distance of the actions in added counts, shape (...).

        Jensen-Shannon where they are discrete, else Wasserstein, the mean of the dimensions.
        """
        if isinstance(self.actions, int):
            return jensen_shannon(a[..., : self.actions], b[..., : self.actions])
        end = sum(map(len, self.actions.points))
        distance: Floats = self.actions.distances(a[..., :end], b[..., :end]).mean(axis=-1)
        return distance

    def state_distances(self, a: Floats, b: Floats) -> Floats:
        """Return the distance of the states in each dimension, in its unit."""
        start = -sum(map(len, self.states.points))
        return self.states.distances(a[..., start:], b[..., start:])


def _edges(values: Floats) -> Floats:
    if (values == np.rint(values)).all():
        return np.arange(values.min(), values.max() + 2) - 0.5
    return np.linspace(values.min(), values.max(), BINS + 1)

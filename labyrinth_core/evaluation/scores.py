"""Episodes, the scores that follow from them, and the confidence intervals of their means.

The interval of one seed says how this policy does on other labyrinths; that of several seeds, how
other seeds of the method do. Every seed is evaluated on the same labyrinths, so the variance of the
mean is the variance by seeds plus the variance by labyrinths, minus the residual that both contain
(Owen 2007, "The pigeonhole bootstrap"). The margin is a quantile of Student's t, with the degrees
of freedom of Satterthwaite (1946).

This alone would be too narrow near the ends of the range, and would have no width at 0% or 100%. So
z^2 labyrinths are added, half with the lowest possible value and half with the highest, as by
Agresti and Coull (1998), "Approximate is better than exact". docs/studies/results.md has a
simulation of how often the interval contains the true mean.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from math import fsum, inf, pi, sqrt, tan
from statistics import NormalDist
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.evaluation.labyrinth_arrays import LabyrinthArrays
from labyrinth_core.world import RULES

OUTCOMES = {
    "solved": "the goal is reached",
    "loop": "the agent goes round between cells until the episode is cut",
    "wall": "the agent walks into a wall or a locked door until the episode is cut",
    "ice": "the agent steps on ice",
    "cut": "a fixed route ends elsewhere than on the goal",
}
"""Outcome of an episode -> what happens."""

ACCURACIES = ("accuracy_on_demonstrations", "accuracy_elsewhere")
"""The shares of optimal actions; see `Scores`."""


@dataclass(frozen=True, eq=False)
class Episodes:
    """The results of one episode in each of L labyrinths; shapes are (E, L) for E episodes each."""

    outcomes: NDArray[np.str_]
    """Keys of `OUTCOMES`, shape (L,)."""
    moves: NDArray[np.int64]
    """Numbers of steps, those into walls included, shape (L,)."""
    cells: int
    """The number of cells of a labyrinth."""

    @classmethod
    def of_letters(
        cls, letters: Sequence[str], moves: Sequence[Sequence[int]], cells: int
    ) -> Episodes:
        """Return E episodes in each of L labyrinths, from E texts as `letters` returns them."""
        names = {name[0]: name for name in OUTCOMES}
        outcomes = np.array([[names[letter] for letter in row] for row in letters])
        return cls(outcomes, np.array(moves, np.int64), cells)

    @property
    def letters(self) -> list[str]:
        """One text per episode E: the first letter of the outcome in each labyrinth."""
        return ["".join(name[0] for name in row) for row in np.atleast_2d(self.outcomes).tolist()]

    @property
    def step_limit(self) -> int:
        """The number of steps after which an episode is cut."""
        return RULES.step_limit * self.cells

    @property
    def solved(self) -> NDArray[np.bool_]:
        """Whether the goal was reached, shape (L,)."""
        solved: NDArray[np.bool_] = self.outcomes == "solved"
        return solved

    @property
    def returns(self) -> NDArray[np.float64]:
        """Sums of the rewards, shape (L,); exactly -4 for an episode that is cut.

        Computed as a product, since a sum of many small penalties gathers rounding errors.
        """
        ends = np.select(
            [self.solved, self.outcomes == "ice"], [RULES.goal_reward, RULES.ice_reward]
        )
        returns: NDArray[np.float64] = (
            ends - RULES.step_penalty * (self.moves - (ends != 0)) / self.cells
        )
        return returns


@dataclass(frozen=True, eq=False)
class Scores:
    """The results of episodes in each of L labyrinths, and the accuracy over all their states."""

    episodes: Episodes
    """The results, of shape (L,), or (E, L) for E episodes in each labyrinth."""
    labyrinth_ids: NDArray[np.int64]
    """The id of each labyrinth, shape (L,)."""
    distance: NDArray[np.int64]
    """The number of moves on a shortest route, shape (L,)."""
    accuracy_on_demonstrations: float | None = None
    """The share of optimal actions in the states where the dataset's episodes act; None for a
    policy with memory or random draws, whose action does not depend on the state alone."""
    accuracy_elsewhere: float | None = None
    """The share of optimal actions in all other states; None if there are no such states."""
    known_route: NDArray[np.bool_] | None = None
    """Whether an optimal route of each labyrinth is a demonstrated route of train or a part of one,
    shape (L,), as computed by `TrainMemory.figures`; None if unknown."""

    @staticmethod
    def by_labyrinth(values: NDArray[Any]) -> NDArray[np.float64]:
        """Return the mean of the episodes in each labyrinth, shape (L,), from (L,) or (E, L).

        Several episodes are of one policy, so they say nothing about other seeds.
        """
        means: NDArray[np.float64] = np.atleast_2d(values).mean(axis=0, dtype=np.float64)
        return means

    @staticmethod
    def return_interval(returns: NDArray[np.float64]) -> tuple[float, float]:
        """Return the interval of the mean return; see `interval`.

        A return below that of an episode that is cut, as on ice, counts as possible only if there
        is one.

        Args:
            returns: The mean return for each seed and labyrinth, shape (seeds, labyrinths).
        """
        lowest = min(-RULES.step_limit * RULES.step_penalty, float(returns.min()))
        return interval(returns, ends=(lowest, RULES.goal_reward))

    @classmethod
    def of(cls, episodes: Episodes, arrays: LabyrinthArrays) -> Scores:
        """Return the scores of any policy's episodes in the labyrinths of a split."""
        return cls(episodes, arrays.labyrinth_ids, arrays.distance)

    @property
    def sr(self) -> float:
        """Success rate: the share of labyrinths that were solved."""
        return float(self.episodes.solved.mean())

    @property
    def sr_within_cells(self) -> float:
        """Success rate within as many steps as a labyrinth has cells.

        With the benchmark's limit of 40 steps per cell, random actions solve most labyrinths.
        """
        episodes = self.episodes
        return float((episodes.solved & (episodes.moves <= episodes.cells)).mean())

    @property
    def spl(self) -> float:
        """Success weighted by path length (Anderson et al. 2018, section 4.1, "SPL").

        The mean over episodes of shortest moves divided by moves taken, or 0 if unsolved.
        """
        return float(self.weighted.mean())

    @property
    def weighted(self) -> NDArray[np.float64]:
        """Each episode's contribution to the mean `spl`, shape (L,)."""
        weighted: NDArray[np.float64] = self.episodes.solved * self.distance / self.episodes.moves
        return weighted

    @property
    def sr_known_route(self) -> float | None:
        """Success rate where `known_route` holds; None without such labyrinths."""
        known = self.known_route
        return None if known is None else mean_if_any(self.episodes.solved[..., known])

    @property
    def sr_new_route(self) -> float | None:
        """Success rate where `known_route` does not hold; None without such labyrinths."""
        known = self.known_route
        return None if known is None else mean_if_any(self.episodes.solved[..., ~known])

    @property
    def aer(self) -> float:
        """Average episodic return."""
        return float(self.episodes.returns.mean())

    @property
    def path_efficiency(self) -> float | None:
        """Moves on a shortest route divided by moves taken, averaged over the solved episodes."""
        return mean_if_any((self.distance / self.episodes.moves)[self.episodes.solved])

    def summary(self) -> dict[str, float]:
        """Return the figures that baselines have as well."""
        return {
            "sr": self.sr,
            "sr_within_cells": self.sr_within_cells,
            "spl": self.spl,
            "aer": self.aer,
            "aer_std": float(self.episodes.returns.std()),
        }

    @property
    def failed(self) -> list[str]:
        """The ids of the labyrinths that were not solved in every episode, in hexadecimal."""
        solved = np.atleast_2d(self.episodes.solved).all(axis=0)
        return [f"{number:016x}" for number in self.labyrinth_ids[~solved].tolist()]

    @property
    def by_distance(self) -> dict[int, tuple[int, int]]:
        """Moves on a shortest route -> successful episodes and all episodes in such labyrinths."""
        solved = np.atleast_2d(self.episodes.solved)
        return {
            moves: (int(solved[:, at].sum()), int(solved[:, at].size))
            for moves in np.unique(self.distance).tolist()
            for at in [self.distance == moves]
        }

    def figures(self) -> dict[str, Any]:
        """Return the figures in plain types; intervals are over labyrinths.

        `known_route` has a digit for each labyrinth, 1 if the route is known, else 0.
        """
        known, episodes = self.known_route, self.episodes
        return {
            "labyrinths": len(self.distance),
            **self.summary(),
            "sr_known_route": self.sr_known_route,
            "sr_new_route": self.sr_new_route,
            "known_route": None if known is None else "".join(map(str, known.astype(int))),
            "path_efficiency": self.path_efficiency,
            "accuracy_on_demonstrations": self.accuracy_on_demonstrations,
            "accuracy_elsewhere": self.accuracy_elsewhere,
            "failures": {
                name: int((episodes.outcomes == name).sum())
                for name in OUTCOMES
                if name in episodes.outcomes[~episodes.solved]
            },
            "sr_interval": list(interval(Scores.by_labyrinth(episodes.solved)[None])),
            "aer_interval": list(
                Scores.return_interval(Scores.by_labyrinth(episodes.returns)[None])
            ),
        }


_AVERAGED = (
    *("spl", "sr_within_cells", "sr_known_route", "sr_new_route", "path_efficiency"),
    *ACCURACIES,
)
"""Figures of `Scores` that are averaged over seeds; None if no seed defines them."""


def over_seeds(scores: Sequence[Scores]) -> dict[str, Any]:
    """Return the figures of the scores of seeds on a split; one seed is enough.

    `spl`, `sr` and `aer` have an interval over seeds and labyrinths, with ends `_low` and
    `_high`. `aer_std` is the standard deviation over labyrinths, averaged over seeds. Each kind
    of failure has its share of all episodes. `by_distance` says how many episodes succeed for
    each length of the shortest route, such as `8: 3 of 5`.
    """
    outcomes = np.concatenate([np.atleast_2d(each.episodes.outcomes) for each in scores])
    values = {
        "spl": np.stack([Scores.by_labyrinth(each.weighted) for each in scores]),
        "sr": solved_by(scores),
        "aer": np.stack([Scores.by_labyrinth(each.episodes.returns) for each in scores]),
    }
    figures: dict[str, Any] = {
        name: _mean(getattr(each, name) for each in scores) for name in _AVERAGED
    }
    figures |= {name: float(values[name].mean()) for name in ("sr", "aer")}
    for name, by_seed in values.items():
        bounds = Scores.return_interval(by_seed) if name == "aer" else interval(by_seed)
        figures[f"{name}_low"], figures[f"{name}_high"] = bounds
    for failure in ("loop", "wall", "ice"):
        figures[failure] = float((outcomes == failure).mean())
    counted = [each.by_distance for each in scores]
    lengths = (
        f"{moves}: {sum(each[moves][0] for each in counted)} of "
        f"{sum(each[moves][1] for each in counted)}"
        for moves in counted[0]
    )
    return figures | {
        "labyrinths": len(scores[0].distance),
        "aer_std": float(np.mean([each.episodes.returns.std() for each in scores])),
        "by_distance": "; ".join(lengths),
    }


def solved_by(seeds: Sequence[Scores]) -> NDArray[np.float64]:
    """Return the share of solved episodes for each labyrinth, shape (seeds, labyrinths)."""
    return np.stack([Scores.by_labyrinth(each.episodes.solved) for each in seeds])


def _mean(values: Iterable[float | None]) -> float | None:
    defined = [value for value in values if value is not None]
    return fsum(defined) / len(defined) if defined else None


def mean_if_any(values: NDArray[Any]) -> float | None:
    """Return the mean of values; None if there are none."""
    return float(values.mean()) if values.size else None


# Confidence intervals, without resampling.

CONFIDENCE = 0.95
_Z = NormalDist().inv_cdf((1 + CONFIDENCE) / 2)

_DIGITS = 12
"""Bounds are rounded to this number of decimal places, since processors round sums differently."""


def interval(
    values: NDArray[np.float64],
    minus: NDArray[np.float64] | None = None,
    ends: tuple[float, float] = (0.0, 1.0),
) -> tuple[float, float]:
    """Return the bounds of the interval of the mean at the level `CONFIDENCE`.

    The mean of the values is always within the bounds.

    Args:
        values: A value for each seed and labyrinth, shape (seeds, labyrinths).
        minus: Values of the same seeds on other labyrinths, whose mean is subtracted.
        ends: The lowest and the highest possible value, of `minus` as well.
    """
    low, high = ends
    if minus is None:
        lowest, highest, parts = low, high, [_part(values, low, high, _Z**2)]
    else:
        lowest, highest = low - high, high - low
        others = _part(-minus, -high, -low, _Z**2 / 2)
        parts = [_part(values, low, high, _Z**2 / 2), others]
    seeds = len(values)
    of_seeds = np.sum([each.of_seeds for each in parts], axis=0)
    by_seeds = float(of_seeds.var(ddof=seeds > 1)) / seeds
    by_labyrinths = sum(each.by_labyrinths for each in parts)
    # Both variances contain the residual, but their sum is no less than either.
    variance = by_seeds + by_labyrinths - sum(each.residual for each in parts)
    variance = max(variance, by_seeds, by_labyrinths) + sum(each.added for each in parts)
    squares = by_seeds**2 / max(seeds - 1, 1)
    squares += sum(each.by_labyrinths**2 / max(each.labyrinths - 1, 1) for each in parts)
    freedom = max(variance**2 / squares, 1) if squares else inf
    margin = _quantile(freedom) * sqrt(variance)
    mean, centre = float(values.mean()), float(of_seeds.mean())
    if minus is not None:
        mean -= float(minus.mean())
    bounds = max(min(mean, centre - margin), lowest), min(max(mean, centre + margin), highest)
    return round(bounds[0], _DIGITS), round(bounds[1], _DIGITS)


class _Part(NamedTuple):
    """The mean over a set of labyrinths and some added ones, and the parts of its variance."""

    of_seeds: NDArray[np.float64]
    """The mean of each seed, shape (seeds,)."""
    labyrinths: int
    by_labyrinths: float
    """The variance of the mean by the choice of labyrinths."""
    residual: float
    """How much of the variance by labyrinths, and by seeds, is residual."""
    added: float
    """The variance of the mean by the added labyrinths."""


def _part(values: NDArray[np.float64], low: float, high: float, added: float) -> _Part:
    """Return the mean of values and of as many labyrinths as `added`, half of each end."""
    seeds, labyrinths = values.shape
    share = labyrinths / (labyrinths + added)
    rows, columns = values.mean(axis=1), values.mean(axis=0)
    mean, middle = float(values.mean()), (low + high) / 2
    rest = values - rows[:, None] - columns + mean
    several = seeds > 1 and labyrinths > 1
    between = share * (mean - middle) ** 2 + ((high - low) / 2) ** 2
    return _Part(
        share * rows + (1 - share) * middle,
        labyrinths,
        share**2 * float(columns.var(ddof=several)) / labyrinths,
        share**2 * float(np.square(rest).mean()) / ((seeds - 1) * (labyrinths - 1) or inf),
        (1 - share) * between / (labyrinths + added),
    )


def _quantile(freedom: float) -> float:
    """Return the quantile of Student's t for the upper bound; `freedom` is at least 1.

    With t = sqrt(freedom) * tan(angle), the density of the angle is a power of its cosine.
    """
    if freedom > 1_000:
        return _Z
    angles = np.linspace(0, pi / 2, 1_001)
    density = np.cos(angles) ** (freedom - 1)
    below = np.cumsum(density[1:] + density[:-1])
    angle = np.interp(CONFIDENCE * below[-1], below, angles[1:])
    return sqrt(freedom) * tan(angle)

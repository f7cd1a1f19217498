"""The scores of a policy on a split: the results of its episodes, and the resulting figures."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.evaluation.answers import Policy
from labyrinth_core.evaluation.intervals import interval
from labyrinth_core.evaluation.labyrinth_arrays import LabyrinthArrays
from labyrinth_core.evaluation.playing import OUTCOMES, Episodes, decisions, follow
from labyrinth_core.world import RULES

ACCURACIES = ("accuracy_on_demonstrations", "accuracy_elsewhere")
"""The shares of optimal actions; see `Scores`."""


@dataclass(frozen=True, eq=False)
class Scores:
    """The results of episodes in each of L labyrinths, and the accuracy over all their states."""

    WHY_SPL: ClassVar[str] = (
        "SPL (success weighted by path length) comes before SR (success rate), because SR rewards "
        "wandering:\nwithin 40 steps per cell even random steps solve most labyrinths."
    )
    """The sentence printed with every table of scores."""

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
        return None if known is None else _mean(self.episodes.solved[..., known])

    @property
    def sr_new_route(self) -> float | None:
        """Success rate where `known_route` does not hold; None without such labyrinths."""
        known = self.known_route
        return None if known is None else _mean(self.episodes.solved[..., ~known])

    @property
    def aer(self) -> float:
        """Average episodic return."""
        return float(self.episodes.returns.mean())

    @property
    def path_efficiency(self) -> float | None:
        """Moves on a shortest route divided by moves taken, averaged over the solved episodes."""
        return _mean((self.distance / self.episodes.moves)[self.episodes.solved])

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


def score(policy: Policy, arrays: LabyrinthArrays) -> Scores:
    """Return the scores of a policy without memory, by look-ups in all states at once.

    Raises:
        PolicyError: The policy raises an error, or answers with anything but actions.
    """
    acting = np.flatnonzero(~arrays.terminal)
    actions = np.zeros(len(arrays.terminal), np.int64)
    actions[acting] = decisions(policy, arrays, acting)
    right = np.take_along_axis(arrays.optimal, actions[:, None], axis=1)[:, 0]
    solvable, shown = arrays.optimal.any(axis=1), arrays.on_demonstration
    return Scores(
        episodes=follow(arrays, actions),
        labyrinth_ids=arrays.labyrinth_ids,
        distance=arrays.distance,
        accuracy_on_demonstrations=_mean(right[solvable & shown]),
        accuracy_elsewhere=_mean(right[solvable & ~shown]),
    )


def _mean(values: NDArray[Any]) -> float | None:
    return float(values.mean()) if values.size else None

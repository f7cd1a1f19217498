"""DAgger in the authors' code: the solver acts, and the learner never does.

After each epoch, episodes of the solver in labyrinths of train are added to the rows. The solver
takes the first route that a depth-first search finds, which need not be the shortest. The order in
which the authors' search tries the actions is unknown; ours is up, right, down, left. The
labyrinths are sampled with replacement. The optimizer keeps its state from epoch to epoch.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from labyrinth_core.learning.learner import setting
from labyrinth_core.world import Solver

from . import bc, learner


@dataclass(frozen=True)
class Settings(learner.Settings):
    """An epoch is one pass over the rows."""

    episodes: int = setting(10, "number of the solver's episodes added per epoch", at_least=1)


class Method(bc.Method):
    """The policy, and the rows."""

    def epoch(self) -> dict[str, float]:
        figures = super().epoch()
        self.join()
        return figures

    def join(self) -> None:
        """Add the solver's episodes to the rows, without their last states."""
        arrays = self.problem.arrays
        states, labels = [], []
        for number in self.problem.rng.integers(len(arrays.initial), size=self.settings.episodes):
            state = int(arrays.initial[number])
            for action in Solver(arrays.labyrinths[number]).simple_routes(limit=1)[0]:
                states.append(state)
                labels.append(action)
                state = int(arrays.next_state[state, action])
        self.states = np.concatenate([self.states, states])
        self.labels = np.concatenate([self.labels, labels])

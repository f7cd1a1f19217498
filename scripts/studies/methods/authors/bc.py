"""Behavioural cloning in the authors' code: cross-entropy on all rows.

These include the last row of each episode: the agent on the goal, with the previous row's action.
"""

from __future__ import annotations

from labyrinth_core.learning.problem import Problem

from .learner import AuthorsLearner, Settings, rows_of

__all__ = ["Method", "Settings"]


class Method(AuthorsLearner):
    """The policy, and the rows that it learns from: `states` with their `labels`."""

    def __init__(self, problem: Problem, settings: Settings) -> None:
        super().__init__(problem, settings)
        self.states, self.labels, _ = rows_of(problem.arrays)

    def epoch(self) -> dict[str, float]:
        loss = self.clone(self.policy, self.optimizer, (self.states,), self.labels)
        return {"loss": loss, "rows": len(self.states)}

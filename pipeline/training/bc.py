"""Behavioural cloning (Pomerleau 1988, ALVINN): a classifier of the demonstrated actions.

The loss is the cross-entropy of the demonstrated action, -log pi(a | s), over all pairs (s, a).

Departures: Adam and the networks of the supplement instead of the paper's; pairs in random order.
"""

from __future__ import annotations

from dataclasses import dataclass

from pipeline.training.method import BaseSettings, Learner


@dataclass(frozen=True)
class Settings(BaseSettings):
    """An epoch is one pass over the demonstrations."""


class Method(Learner):
    """The policy alone."""

    def epoch(self) -> dict[str, float]:
        steps = self.problem.demonstrations
        return {"loss": self.clone(self.policy, self.optimizer, (steps.states,), steps.actions)}

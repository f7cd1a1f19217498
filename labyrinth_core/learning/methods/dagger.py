"""DAgger (Ross, Gordon and Bagnell 2011): the learner acts, and the expert labels its states.

Algorithm 3.1 of the paper with beta_1 = 1 and beta_i = 0 afterwards, which the paper calls
parameter-free. D begins as the demonstrations. In each round the policy acts once in every training
labyrinth, the expert labels the visited states, these are added to D, and the policy is fitted to D
by cross-entropy. The expert is the solver; its label is an optimal action, sampled once per state.

Departures: D is a set, to which a state is added only once; an episode ends when the policy returns
to a state, because it would only repeat itself from there; the policy continues from its last
weights instead of being fitted from scratch; the iteration that is best on validation is kept, as
in the paper, but policies are evaluated every few epochs instead of every round.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.learning.learner import BaseSettings, Learner, setting
from labyrinth_core.learning.problem import Problem, draw


@dataclass(frozen=True)
class Settings(BaseSettings):
    """An epoch is one pass over D."""

    epochs_a_round: int = setting(
        5, "number of passes over D before the policy acts again", at_least=1
    )


class Method(Learner):
    """The policy, and the dataset D: `states` with their `labels`.

    If each epoch has new labyrinths, D is of these alone, and from the second epoch on the policy
    acts in them first: each epoch is a round.
    """

    renews = True

    def __init__(self, problem: Problem, settings: Settings) -> None:
        super().__init__(problem, settings)
        self.states = problem.demonstrations.states
        self.labels = problem.demonstrations.actions
        self.epochs = 0

    def renew(self, problem: Problem) -> None:
        super().renew(problem)
        self.states, self.labels, _ = problem.demonstrations

    def epoch(self) -> dict[str, float]:
        every = self.settings.epochs_a_round if self.problem.renewed is None else 1
        if self.epochs and self.epochs % every == 0:
            self.aggregate(self.visited())
        self.epochs += 1
        loss = self.clone(self.policy, self.optimizer, (self.states,), self.labels)
        return {"loss": loss, "aggregated": len(self.states)}

    def visited(self) -> NDArray[np.int64]:
        """Play a greedy episode in each labyrinth; return the states in which the policy acts."""
        arrays = self.problem.arrays
        actions = self.outputs(self.policy).argmax(1).cpu().numpy()
        seen = np.zeros(len(arrays.observations), np.bool_)
        where = arrays.initial
        while len(where):
            seen[where] = True
            where = arrays.next_state[where, actions[where]]
            where = where[~seen[where] & ~arrays.terminal[where]]
        return np.flatnonzero(seen)

    def aggregate(self, visited: NDArray[np.int64]) -> None:
        """Add to D the visited states that it lacks, with the expert's labels."""
        optimal = self.problem.arrays.optimal
        new = np.setdiff1d(visited, self.states)
        choices = optimal[new] / optimal[new].sum(axis=1, keepdims=True)
        self.states = np.concatenate([self.states, new])
        self.labels = np.concatenate([self.labels, draw(choices, self.problem.rng)])

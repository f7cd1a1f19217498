"""Behavioural cloning from observation, BCO(alpha) (Torabi, Warnell and Stone 2018).

Algorithm 1 of the paper: an inverse dynamics model M(a | s, s') is fitted by maximum likelihood to
the steps I_pre of a random policy, here the split `random`. It labels each pair of states in the
demonstrations with its most likely action, and the policy is fitted to these labels; demonstrated
actions are never used. Then, in each round, the policy takes alpha |I_pre| steps of its own, which
are added to I; the model is fitted to I, the demonstrations are relabelled, and the policy is
fitted again. The policy samples its actions, and continues its episodes from round to round.

Steps into walls, where s' = s reveals only that there is a wall, stay in I, since the paper gives
no reason to exclude them; they are counted separately (`stayed`).

Departures: the model sees both pictures, stacked to six channels, through the run's encoder,
instead of vectors; model and policy continue from their last weights; the number of passes is
fixed, whereas the paper trains until convergence.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.learning.learner import BaseSettings, Learner, setting
from labyrinth_core.learning.networks.network import ACTIONS, double
from labyrinth_core.learning.problem import Problem, roll_out, softmax


@dataclass(frozen=True)
class Settings(BaseSettings):
    """An epoch is one pass of the policy over the demonstrations."""

    alpha: float = setting(
        0.1, "number of the policy's steps in a round, as a multiple of the random policy's steps"
    )
    epochs_a_round: int = setting(10, "number of passes before the policy acts again", at_least=1)
    model_epochs: int = setting(
        2, "number of passes of the inverse dynamics model over I in a round", at_least=1
    )


class Method(Learner):
    """The policy, the inverse dynamics model, and I, an array of rows (s, a, s'), shape (N, 3).

    If each epoch has new labyrinths, I is of those of the first epoch of its round: the steps of a
    random policy and of the policy in them.
    """

    renews = True

    def __init__(self, problem: Problem, settings: Settings) -> None:
        super().__init__(problem, settings)
        self.model = self.network(frames=2)
        self.model_optimizer = self.adam(self.model)
        self.scores = np.zeros((len(problem.demonstrations.states), ACTIONS))
        self.epochs = 0
        self.model_loss = 0.0
        self.begin()

    def begin(self) -> None:
        """Set I to the steps of the random policy, and put the policy on each start."""
        self.before = np.stack(self.problem.exploration(), axis=1)
        self.experience = self.before
        self.where = self.problem.arrays.initial.copy()
        self.taken = np.zeros_like(self.where)

    def renew(self, problem: Problem) -> None:
        super().renew(problem)
        if self.epochs % self.settings.epochs_a_round == 0:
            self.begin()
        else:
            self.infer()

    def epoch(self) -> dict[str, float]:
        if self.epochs % self.settings.epochs_a_round == 0:
            if self.epochs:
                self.explore()
            self.fit_model()
        self.epochs += 1
        states = self.problem.demonstrations.states
        loss = self.clone(self.policy, self.optimizer, (states,), self.labels())
        states, _, after = self.experience.T
        return {
            "loss": loss,
            "model_loss": self.model_loss,
            "experience": len(self.experience),
            "stayed": int((states == after).sum()),
        }

    def explore(self) -> None:
        """Let the policy act, and add its steps to I."""
        arrays, count = self.problem.arrays, self.settings.alpha * len(self.before)
        steps = -(-round(count) // len(arrays.initial))
        if not steps:  # BCO(0): the model is fitted to the steps of the random policy only.
            return
        probabilities = softmax(self.outputs(self.policy))
        own = roll_out(arrays, probabilities, self.where, self.taken, steps, self.problem.rng)
        self.experience = np.concatenate([self.experience, own.transitions])

    def fit_model(self) -> None:
        """Fit the model to I, and infer the actions of the demonstrations."""
        states, actions, after = self.experience.T
        for _ in range(self.settings.model_epochs):
            self.model_loss = self.clone(self.model, self.model_optimizer, (states, after), actions)
        self.infer()

    def infer(self) -> None:
        """Compute the model's scores for the state pairs of the demonstrations."""
        shown = self.problem.demonstrations
        outputs = self.outputs(self.model, shown.states, shown.next_states)
        self.scores = double(outputs).cpu().numpy()

    def labels(self) -> NDArray[np.int64]:
        """Return an action for each state pair of the demonstrations, shape (N,)."""
        labels: NDArray[np.int64] = self.scores.argmax(axis=1)
        return labels

"""Behavioural cloning from observation, BCO(alpha) (Torabi, Warnell and Stone 2018).

Algorithm 1 of the paper: an inverse dynamics model M(a | s, s') is fitted by maximum likelihood to
the steps I_pre of a random policy, here the split `random`; it labels the pairs of states of the
demonstrations, whose actions are never looked at; the policy is fitted to the labels. Then, round
by round, the policy takes alpha |I_pre| steps of its own, which are added to I, the model is
fitted to I, the demonstrations are labelled anew, and the policy is fitted again. Labels are the
most likely actions. The policy acts by its probabilities, from where its last round ended.

Steps into walls, of which s' = s tells no action but that there is a wall, stay in I as the paper
has no reason to leave them out, and are counted apart (`stayed`).

Departures: the model looks at both pictures one over the other, six channels, through the run's
encoder, where the paper has vectors; model and policy go on from their last weights; the number of
passes is fixed where the paper waits for convergence.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.training.methods.acting import softmax, walk
from pipeline.training.methods.method import BaseSettings, Learner, Problem, setting
from pipeline.training.networks.network import ACTIONS
from pipeline.training.policy import outputs_of


@dataclass(frozen=True)
class Settings(BaseSettings):
    """An epoch is one pass of the policy over the demonstrations."""

    alpha: float = setting(
        "number of steps of the policy in a round, as a multiple of those of the random policy"
    )
    epochs_a_round: int = setting("number of passes before the policy acts again", at_least=1)
    model_epochs: int = setting(
        "number of passes of the inverse dynamics model over I in a round", at_least=1
    )


class Method(Learner):
    """The policy, the inverse dynamics model, and I, an array (N, 3) of s, a, s'."""

    def __init__(self, problem: Problem, settings: Settings) -> None:
        super().__init__(problem, settings)
        self.model = self.network(frames=2)
        self.model_optimizer = self.adam(self.model)
        self.before = np.stack(problem.exploration(), axis=1)
        self.experience = self.before
        worlds = problem.worlds
        self.where, self.taken = worlds.initial.copy(), np.zeros_like(worlds.initial)
        self.scores = np.zeros((len(problem.demonstrations.states), ACTIONS))
        self.epochs = 0
        self.model_loss = 0.0

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
        """Let the policy take its steps, and add them to I."""
        self.experience = np.concatenate([self.experience, self.steps_taken()])

    def steps_taken(self) -> NDArray[np.int64]:
        """Return new steps of the policy, an array (N, 3)."""
        worlds, count = self.problem.worlds, self.settings.alpha * len(self.before)
        steps = -(-round(count) // len(worlds.initial))
        if not steps:  # BCO(0): the model learns from the random policy alone.
            return self.before[:0]
        probabilities = softmax(self.outputs(self.policy))
        taken = walk(worlds, probabilities, self.where, self.taken, steps, self.problem.rng)
        return np.stack([taken.states, taken.actions, taken.next_states], axis=2).reshape(-1, 3)

    def fit_model(self) -> None:
        """Fit the model to I, and look with it at the demonstrations' pairs of states."""
        states, actions, after = self.experience.T
        for _ in range(self.settings.model_epochs):
            self.model_loss = self.clone(self.model, self.model_optimizer, (states, after), actions)
        demonstrations = self.problem.demonstrations
        pairs = self.see(demonstrations.states, demonstrations.next_states)
        self.scores = outputs_of(self.model, pairs).double().cpu().numpy()

    def labels(self) -> NDArray[np.int64]:
        """Return an action for each pair of states of the demonstrations."""
        labels: NDArray[np.int64] = self.scores.argmax(axis=1)
        return labels

"""IUPE in the authors' code: BCO (`bco.py`) with sampled labels and actions.

A label is sampled by counting the cumulative probabilities below random numbers. One number per
pair would be correct; the code draws one per *action*, and uses the same four numbers for all pairs
of a batch. So it can sample an action of probability 0 that lies between two likely ones.

During training the policy samples its actions, correctly, for experience and when it is evaluated.
The policy with the best return on the labyrinths of train is kept.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from labyrinth_core.learning.problem import softmax

from . import bco, learner


@dataclass(frozen=True)
class Settings(learner.Settings):
    """An epoch is one pass of the policy over the demonstrations."""

    learning_rate: float = 0.001


class Method(bco.Method):
    """The policy, the inverse dynamics model, and all steps."""

    selected_by = "train_return"

    def learn(self, probabilities: NDArray[np.float64]) -> float:
        states, rng = self.problem.demonstrations.states, self.problem.rng
        self.policy.train()
        total = 0.0
        for batch in self.batches(len(states)):
            labels = draw_labels(probabilities[batch], rng)
            scores = self.policy(self.see(states[batch]))
            loss = functional.cross_entropy(scores, self.tensor(labels))
            self.descend(self.optimizer, loss)
            total += loss.item() * len(batch)
        return total / len(states)

    @classmethod
    def chances_in_training(cls, scores: Tensor) -> NDArray[np.float64]:
        return softmax(scores)


def draw_labels(probabilities: NDArray[np.float64], rng: np.random.Generator) -> NDArray[np.int64]:
    """Return a label for each pair of a batch, shape (B,), from only four random numbers."""
    cumulative = probabilities.cumsum(axis=1)
    cumulative[:, -1] = 1  # Rounding may leave it below 1.
    labels: NDArray[np.int64] = (cumulative < rng.random(cumulative.shape[1])).sum(axis=1)
    return labels

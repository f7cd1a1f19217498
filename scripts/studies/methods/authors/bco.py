"""BCO in the authors' code.

An epoch is a pass of the inverse dynamics model over all steps, then a pass of the policy over the
state pairs of the demonstrations, labelled with the model's most likely actions. The model encodes
both pictures with one encoder, and an MLP combines the features. Every `evaluate_every` epochs, the
policy plays episodes on train, cut only at the step limit, and their steps are added. The last
policy is kept, because the code compares each evaluation with the worst possible one.
"""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from labyrinth_core.learning.networks.network import WIDTH, Network, as_input
from labyrinth_core.learning.problem import Problem, softmax
from labyrinth_core.learning.spec import NetworkSpec

from .learner import AuthorsLearner, Settings, try_out

__all__ = ["InverseDynamics", "Method", "Settings"]


class InverseDynamics(nn.Module):
    """One encoder for a state and its successor, followed by the classifier of Table 1."""

    def __init__(self, spec: NetworkSpec) -> None:
        super().__init__()
        single = Network(spec)
        self.encoder = single.encoder
        first = nn.Linear(2 * single.encoder.features, WIDTH)
        self.classifier = nn.Sequential(first, *list(single.classifier)[1:])

    def forward(self, pairs: Tensor) -> Tensor:
        """Return the scores of the actions, shape (batch, 4), for pairs from `Learner.see`."""
        features = [self.encoder(as_input(each)) for each in pairs.chunk(2, -1)]
        scores: Tensor = self.classifier(torch.cat(features, 1))
        return scores


class Method(AuthorsLearner):
    """The policy, the inverse dynamics model, and all steps as rows (s, a, s'), shape (N, 3)."""

    selected_by = "epoch"
    visits = None

    def __init__(self, problem: Problem, settings: Settings) -> None:
        super().__init__(problem, settings)
        self.model = InverseDynamics(problem.spec).to(problem.device)
        self.model_optimizer = self.adam(self.model)
        self.experience = np.stack(problem.exploration(), axis=1)
        self.epochs = 0

    def epoch(self) -> dict[str, float]:
        states, actions, after = self.experience.T
        model_loss = self.clone(self.model, self.model_optimizer, (states, after), actions)
        shown = self.problem.demonstrations
        scores = self.outputs(self.model, shown.states, shown.next_states)
        loss = self.learn(softmax(scores))
        self.epochs += 1
        if self.epochs % self.settings.evaluate_every == 0:
            self.explore()
        return {"loss": loss, "model_loss": model_loss, "experience": len(self.experience)}

    def learn(self, probabilities: NDArray[np.float64]) -> float:
        """Fit the policy to the model's labels in one pass; return the mean loss.

        Args:
            probabilities: The model's probabilities for the demonstrations' pairs, shape (N, 4).
        """
        states = self.problem.demonstrations.states
        return self.clone(self.policy, self.optimizer, (states,), probabilities.argmax(axis=1))

    def explore(self) -> None:
        """Let the policy play one episode in each labyrinth of train; add all its steps."""
        arrays, rng = self.problem.arrays, self.problem.rng
        chances = self.chances_in_training(self.outputs(self.policy))
        _, steps = try_out(arrays, chances, rng, self.visits)
        self.experience = np.concatenate([self.experience, steps])

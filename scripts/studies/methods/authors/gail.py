"""GAIL in the authors' code: the policy never acts.

For each batch of rows, the discriminator is trained by binary cross-entropy to classify (state,
one-hot action of the row) as expert, and (same state, logits of the policy) as not expert. Then the
policy is trained, by back-propagation through the discriminator, so that its logits are classified
as expert. The discriminator gets logits as they are, without a softmax.
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional

from labyrinth_core.learning.networks.network import ACTIONS, Discriminator, as_input
from labyrinth_core.learning.problem import Problem

from . import bc
from .learner import Settings

__all__ = ["Method", "Settings"]


def called(logits: Tensor, value: float) -> Tensor:
    """Return the binary cross-entropy of logits whose label is `value` throughout."""
    return functional.binary_cross_entropy_with_logits(logits, torch.full_like(logits, value))


class Method(bc.Method):
    """The policy, the discriminator, and the rows."""

    def __init__(self, problem: Problem, settings: Settings) -> None:
        super().__init__(problem, settings)
        self.discriminator = Discriminator(problem.spec).to(problem.device)
        self.judge_optimizer = self.adam(self.discriminator)

    def epoch(self) -> dict[str, float]:
        self.policy.train()
        self.discriminator.train()
        totals = torch.zeros(2)
        for batch in self.batches(len(self.states)):
            pictures = self.see(self.states[batch])
            shown = functional.one_hot(self.tensor(self.labels[batch]), ACTIONS).float()
            totals += torch.tensor(self.update(pictures, shown)) * len(batch)
        loss, policy_loss = (totals / len(self.states)).tolist()
        return {"loss": loss, "policy_loss": policy_loss, "rows": len(self.states)}

    def update(self, pictures: Tensor, shown: Tensor) -> tuple[float, float]:
        """Take a gradient step with each network; return the discriminator's loss and the policy's.

        Args:
            pictures: The observations of B rows.
            shown: The one-hot actions of the rows, shape (B, 4).
        """
        logits = self.policy(pictures)
        told_apart = called(self.judge(pictures, shown), 1)
        told_apart = told_apart + called(self.judge(pictures, logits.detach()), 0)
        self.descend(self.judge_optimizer, told_apart)
        fooled = called(self.judge(pictures, logits), 1)
        self.descend(self.optimizer, fooled)
        return told_apart.item(), fooled.item()

    def judge(self, pictures: Tensor, actions: Tensor) -> Tensor:
        """Return the discriminator's logit that each (picture, action vector) is expert."""
        features = self.discriminator.encoder(as_input(pictures))
        logits: Tensor = self.discriminator.classifier(torch.cat([features, actions], 1))
        return logits

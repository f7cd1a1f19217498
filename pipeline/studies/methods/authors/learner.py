"""What the authors' methods have in common: settings, optimizer, and how a policy is tried."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional
from torch.optim import Adam

from labyrinth_core.evaluation.answers import Policy
from labyrinth_core.evaluation.labyrinth_arrays import LabyrinthArrays
from labyrinth_core.evaluation.scores import Scores
from pipeline.studies.methods.authors.trial import VISITS, accuracy, certain, try_out
from pipeline.training.methods.method import BaseSettings, Learner, setting


@dataclass(frozen=True)
class Settings(BaseSettings):
    """Batches of one row are allowed, and usual."""

    batch_size: int = setting("number of rows in a gradient step", at_least=1)


class AuthorsLearner(Learner):
    """A method of the authors; keeps the policy that labels most rows of validation correctly."""

    selected_by = "validation_accuracy"
    visits: int | None = VISITS
    """As `trial.try_out` has it."""

    def adam(self, network: nn.Module) -> Adam:
        # Fused, because Adam is most of the work of a step with one row.
        return Adam(network.parameters(), lr=self.settings.learning_rate, fused=True)

    @classmethod
    def chances(cls, scores: Tensor) -> NDArray[np.float64]:
        """Return the probabilities of the actions of a trained policy, shape (S, 4)."""
        return certain(scores.argmax(1).cpu().numpy())

    @classmethod
    def chances_in_training(cls, scores: Tensor) -> NDArray[np.float64]:
        """Return the same while the policy is trained."""
        return cls.chances(scores)

    @classmethod
    def figures(
        cls, policy: Policy, train: LabyrinthArrays, validation: LabyrinthArrays
    ) -> dict[str, float]:
        # The same numbers are drawn each time, so that trying a policy does not change training.
        rng = np.random.default_rng(0)
        of_train, of_validation = (
            cls.chances_in_training(torch.as_tensor(policy(arrays.observations)))
            for arrays in (train, validation)
        )
        episodes, _ = try_out(train, of_train, rng, cls.visits)
        return {
            "validation_accuracy": accuracy(validation, of_validation, rng),
            "train_return": float(episodes.returns.mean()),
        }

    @classmethod
    def as_tried(cls, policy: Policy, arrays: LabyrinthArrays) -> dict[str, float]:
        chances = cls.chances(torch.as_tensor(policy(arrays.observations)))
        episodes, _ = try_out(arrays, chances, np.random.default_rng(0), cls.visits)
        return Scores.of(episodes, arrays).summary()


def called(logits: Tensor, value: float) -> Tensor:
    """Return the binary cross-entropy of logits that should all have one label."""
    return functional.binary_cross_entropy_with_logits(logits, torch.full_like(logits, value))

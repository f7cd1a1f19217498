"""Behavioural cloning (Pomerleau 1988, ALVINN): a classifier of the demonstrated actions.

The loss is the cross-entropy of the demonstrated action, -log pi(a | s), over all pairs (s, a).

Departures: Adam and the supplement's networks instead of the paper's; pairs in random order.

The settings `augment`, `relabel` and `average` are not part of the method. `planner` uses them by
default; here they show what they contribute without the planner's network.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import fsum
from typing import Any

from torch import Tensor, nn
from torch.nn import functional

from labyrinth_core.errors import DatasetError
from labyrinth_core.evaluation import LabyrinthArrays, PolicyError
from labyrinth_core.learning.learner import BaseSettings, Learner, setting
from labyrinth_core.learning.networks.acting import make_network
from labyrinth_core.learning.networks.network import transform_examples
from labyrinth_core.learning.problem import Problem
from labyrinth_core.learning.spec import NetworkSpec


@dataclass(frozen=True)
class Settings(BaseSettings):
    """An epoch is one pass over the demonstrations, or `pictures` pictures sampled from them."""

    augment: bool = setting(
        False,
        "whether pictures and actions are transformed by the eight symmetries of the square",
    )
    relabel: bool = setting(False, "whether any two states of a route are taken as start and goal")
    average: bool = setting(
        False, "whether the policy averages over the eight symmetries when it acts"
    )
    pictures: int = setting(
        1024, "number of pictures in an epoch that augments or relabels", at_least=1
    )


class Method(Learner):
    """Behavioural cloning; its only state is the policy and its optimizer."""

    renews = True

    def __init__(self, problem: Problem, settings: Any) -> None:
        super().__init__(problem, settings)
        for name in ("augment", "average"):
            if problem.spec.encoder == "mlp" and getattr(settings, name):
                raise PolicyError(
                    f"method.{name} transforms pictures: leave it out with encoder=mlp"
                )
        if settings.relabel:
            require_shortest(problem.arrays)

    @classmethod
    def make(cls, spec: NetworkSpec, settings: Any) -> nn.Module:
        return make_network(spec, average=settings.average)

    def epoch(self) -> dict[str, float]:
        if self.settings.augment or self.settings.relabel:
            return {"loss": self.learn_drawn()}
        steps = self.problem.demonstrations
        return {"loss": self.clone(self.policy, self.optimizer, (steps.states,), steps.actions)}

    def learn_drawn(self, *, whole: bool = False) -> float:
        """Train on `pictures` sampled pictures; return the mean loss of the batches.

        Args:
            whole: Whether to label each picture with the actions in all cells of the route.
        """
        settings = self.settings
        losses: list[float] = []
        self.policy.train()
        for batch in self.batches(settings.pictures):
            examples = self.problem.examples.draw(
                len(batch), self.problem.rng, relabel=settings.relabel, whole=whole
            )
            pictures, labels = (self.tensor(each) for each in examples)
            if settings.augment:
                pictures, labels = transform_examples(pictures, labels)
            loss = self.loss(pictures, labels)
            self.descend(self.optimizer, loss)
            losses.append(loss.item())
        return fsum(losses) / len(losses)

    def loss(self, pictures: Tensor, labels: Tensor) -> Tensor:
        """Return the mean loss of a batch of examples."""
        return functional.cross_entropy(self.policy(pictures), labels)


def require_shortest(arrays: LabyrinthArrays) -> None:
    """Raise a DatasetError unless all demonstrated routes are shortest.

    A part of a longer route need not be a shortest route between its ends.
    """
    longer = int(arrays.demonstrated[~arrays.optimal].sum())
    if longer:
        raise DatasetError(
            f"method.relabel=true: demonstrated routes have to be shortest, but {longer} of "
            f"{arrays.demonstrated.sum()} demonstrated actions are not on a shortest route; give "
            "method.relabel=false"
        )

"""Behavioural cloning (Pomerleau 1988, ALVINN): a classifier of the demonstrated actions.

The loss is the cross-entropy of the demonstrated action, -log pi(a | s), over all pairs (s, a).

Departures: Adam and the networks of the supplement instead of the paper's; pairs in random order.

Three ingredients that are no part of it, and off, can be added; `planner` has them by default, and
here they show what they are worth without its network.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from torch import Tensor, nn
from torch.nn import functional

from pipeline.training.methods.method import BaseSettings, Learner, setting
from pipeline.training.networks.network import Network, NetworkSpec
from pipeline.training.networks.turning import Averaged, turn_examples


@dataclass(frozen=True)
class Settings(BaseSettings):
    """An epoch is one pass over the demonstrations, or over `pictures` drawn from them."""

    augment: bool = setting(
        "whether pictures and actions are turned together, by the eight symmetries of the square"
    )
    relabel: bool = setting("whether any two states of a route are taken as start and goal")
    average: bool = setting("whether the policy looks at a picture in all eight ways when it acts")
    pictures: int = setting("number of pictures in an epoch that augments or relabels", at_least=1)


class Method(Learner):
    """The policy alone."""

    @classmethod
    def make(cls, spec: NetworkSpec, settings: Any) -> nn.Module:
        network = cls.plain(spec, settings)
        return Averaged(network) if settings.average else network

    @classmethod
    def plain(cls, spec: NetworkSpec, settings: Any) -> nn.Module:  # noqa: ARG003
        """Return a fresh network that looks at a picture in one way."""
        return Network(spec)

    def epoch(self) -> dict[str, float]:
        if self.settings.augment or self.settings.relabel:
            return {"loss": self.learn_drawn()}
        steps = self.problem.demonstrations
        return {"loss": self.clone(self.policy, self.optimizer, (steps.states,), steps.actions)}

    def learn_drawn(self, *, whole: bool = False) -> float:
        """Learn from as many pictures as an epoch draws; return the mean loss of the batches.

        Args:
            whole: Whether all cells of a route are labelled in each picture.
        """
        settings = self.settings
        losses: list[float] = []
        self.policy.train()
        for batch in self.batches(settings.pictures):
            examples = self.problem.routes.draw(
                len(batch), self.problem.rng, relabel=settings.relabel, whole=whole
            )
            pictures, labels = (self.tensor(each) for each in examples)
            if settings.augment:
                pictures, labels = turn_examples(pictures, labels)
            loss = self.loss(pictures, labels)
            self.optimizer.zero_grad()
            loss.backward()
            self.step(len(losses) / -(-settings.pictures // settings.batch_size))
            losses.append(loss.item())
        return sum(losses) / len(losses)

    def loss(self, pictures: Tensor, labels: Tensor) -> Tensor:
        """Return the loss of examples."""
        return functional.cross_entropy(self.policy(pictures), labels)

    def step(self, share: float) -> None:  # noqa: ARG002
        """Take a gradient step, with a share of the epoch over."""
        self.optimizer.step()

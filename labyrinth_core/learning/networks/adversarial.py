"""The networks that adversarial imitation adds to a policy: a discriminator and a critic."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from labyrinth_core.learning.networks.network import (
    ACTIONS,
    SLOPE,
    WIDTH,
    Cnn,
    Mlp,
    Network,
    as_input,
)
from labyrinth_core.learning.spec import NetworkSpec


class Discriminator(nn.Module):
    """GAIL's discriminator (Table 2): features and the one-hot action, 1028 inputs, to a logit.

    It has an encoder of its own: the CNN without batch normalisation or, for vectors, which the
    source does not have, `Mlp`.
    """

    def __init__(self, spec: NetworkSpec) -> None:
        super().__init__()
        self.encoder: nn.Module
        if spec.encoder == "mlp":
            self.encoder, features = Mlp(spec), Mlp.features
        else:
            layers = [layer for layer in Cnn() if not isinstance(layer, nn.BatchNorm2d)]
            self.encoder, features = nn.Sequential(*layers), Cnn.features
        self.classifier = nn.Sequential(
            nn.Linear(features + ACTIONS, 256),
            nn.LeakyReLU(SLOPE),
            nn.Linear(256, 256),
            nn.LeakyReLU(SLOPE),
            nn.Linear(256, 1),
        )

    def forward(self, observations: Tensor) -> Tensor:
        """Return the logit that each (observation, action) is demonstrated, shape (batch, 4)."""
        features = self.encoder(as_input(observations)).repeat_interleave(ACTIONS, 0)
        actions = torch.eye(ACTIONS).to(features).repeat(len(observations), 1)
        logits: Tensor = self.classifier(torch.cat([features, actions], 1))
        return logits.view(-1, ACTIONS)


class ActorCritic(nn.Module):
    """A policy network with one more output, the value of the state.

    Args:
        policy: The network; the critic shares all of its layers but the last.
        unit: The unit of the values and of the critic's loss, which keeps that loss from
            outweighing the policy's.
    """

    def __init__(self, policy: Network, unit: float) -> None:
        super().__init__()
        self.unit = unit
        self.policy = policy
        self.value = nn.Linear(WIDTH, 1)

    def forward(self, observations: Tensor) -> Tensor:
        """Return the scores of the four actions, then the value, shape (batch, 5)."""
        hidden = self.policy.hidden(observations)
        last = self.policy.classifier[-1]
        return torch.cat([last(hidden), self.value(hidden) * self.unit], 1)

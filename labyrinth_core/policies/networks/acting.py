"""How a network acts: in evaluation mode and without gradients."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from labyrinth_core.evaluation.answers import PolicyError
from labyrinth_core.policies.spec import PolicySpec

BATCH = 256
"""The number of observations in a forward pass without gradients."""


def outputs_of(network: nn.Module, observations: Tensor) -> Tensor:
    """Return a network's outputs in evaluation mode: no dropout, running statistics, no gradient.

    Whatever acts, labels or judges during training calls this function, with any number of
    observations on the network's device. It leaves the network in the mode in which it was.
    """
    training = network.training
    network.eval()
    try:
        with torch.no_grad():
            return torch.cat([network(batch) for batch in observations.split(BATCH)])
    finally:
        network.train(training)


class NetworkPolicy:
    """The policy of a network."""

    def __init__(self, network: nn.Module) -> None:
        self.network = network

    def __call__(self, observations: NDArray[Any]) -> NDArray[np.float32]:
        """Return the scores of the four actions, shape (B, 4)."""
        device = next(self.network.parameters()).device
        scores = outputs_of(self.network, torch.tensor(observations, device=device))
        array: NDArray[np.float32] = scores.float().cpu().numpy()
        return array


class LoadedPolicy(NetworkPolicy):
    """The policy of a network that was loaded."""

    def __init__(self, network: nn.Module, spec: PolicySpec) -> None:
        super().__init__(network)
        self.spec = spec

    def __call__(self, observations: NDArray[Any]) -> NDArray[np.float32]:
        """Return the scores of the four actions, shape (B, 4).

        Raises:
            PolicyError: It looks at another kind of observation.
        """
        shown = "text"
        if isinstance(observations, np.ndarray):
            shown = "image" if observations.dtype == np.uint8 else "vector"
        if shown != self.spec.observation:
            raise PolicyError(
                f"the policy looks at observation={self.spec.observation}, and is shown {shown}"
            )
        return super().__call__(observations)

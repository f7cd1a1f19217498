"""The policy of a network, and its file."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from safetensors import SafetensorError, safe_open
from torch import Tensor, nn

from labyrinth_core.data.errors import DatasetError, one_line
from pipeline.training.networks.network import MOMENTUM, Network, NetworkSpec
from pipeline.training.tensor_files import save_tensors

BATCH = 256
"""Observations that a policy looks at together, at most."""


def outputs_of(network: nn.Module, observations: Tensor) -> Tensor:
    """Return what a network gives when nothing is learnt: no dropout, running statistics.

    All that acts, labels or judges during training goes through here. The network is left in the
    mode that it was in.

    Args:
        network: Takes a batch of observations.
        observations: Any number of them, on the network's device.
    """
    training = network.training
    network.eval()
    try:
        with torch.no_grad():
            return torch.cat([network(batch) for batch in observations.split(BATCH)])
    finally:
        network.train(training)


def settle(network: nn.Module, observations: Tensor) -> None:
    """Give a network's normalisation the statistics of observations, and leave it in that mode.

    For methods that learn with the network as it acts: a fresh network's running statistics are
    those of nothing.

    Args:
        network: Takes a batch of observations; is in evaluation mode afterwards.
        observations: Any number of them, on the network's device.
    """
    normalising = [each for each in network.modules() if isinstance(each, nn.BatchNorm2d)]
    for layer in normalising:
        layer.reset_running_stats()
        layer.momentum = None  # The mean over all batches, each counting alike.
    network.train()
    with torch.no_grad():
        for batch in observations.split(BATCH):
            network(batch)
    for layer in normalising:
        layer.momentum = MOMENTUM
    network.eval()


class NetworkPolicy:
    """The policy of a network."""

    def __init__(self, network: nn.Module) -> None:
        self.network = network

    def logits(self, observations: NDArray[Any]) -> NDArray[np.float32]:
        device = next(self.network.parameters()).device
        scores = outputs_of(self.network, torch.tensor(observations, device=device))
        array: NDArray[np.float32] = scores.float().cpu().numpy()
        return array


def save_policy(path: Path, tensors: dict[str, Tensor], spec: NetworkSpec) -> None:
    """Write the weights of a policy and the shape of its network, all or nothing."""
    save_tensors(path, tensors, {"network": json.dumps(spec.to_json(), sort_keys=True)})


def load_policy(
    path: Path,
    spec: NetworkSpec,
    device: torch.device | str = "cpu",
    make: Callable[[NetworkSpec], nn.Module] = Network,
) -> NetworkPolicy:
    """Return the policy of a file.

    Args:
        path: As `save_policy` wrote it.
        spec: The network that is expected.
        device: Where it is to be computed.
        make: Returns the network, with any weights: `Learner.make` of the method.

    Raises:
        DatasetError: There is no such file, or it holds the policy of another network.
    """
    try:
        with safe_open(path, framework="pt", device=str(device)) as file:
            there = json.loads((file.metadata() or {}).get("network", "{}"))
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    except FileNotFoundError as error:
        raise DatasetError(f"{path} is not there: stages=[train] makes it") from error
    except (OSError, SafetensorError, ValueError) as error:
        reason = one_line(error)
        raise DatasetError(
            f"{path} cannot be read: {reason}; remove it, and stages=[train] makes it anew"
        ) from error
    wanted = spec.to_json()
    if there != wanted:
        differing = [
            f"{key}={there.get(key)}, not {value}"
            for key, value in wanted.items()
            if there.get(key) != value
        ]
        raise DatasetError(f"{path} is a policy with {'; '.join(differing) or there}")
    network = make(spec).to(device)
    try:
        network.load_state_dict(tensors)
    except RuntimeError as error:
        raise DatasetError(
            f"{path} is not a policy of this network: {one_line(error):.300}"
        ) from error
    return NetworkPolicy(network)

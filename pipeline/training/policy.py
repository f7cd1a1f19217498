"""The policy of a network, and its file."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from safetensors import SafetensorError
from torch import Tensor, nn

from labyrinth_core.data.errors import DatasetError, one_line
from pipeline.training.networks.network import MOMENTUM, Network, NetworkSpec
from pipeline.training.record import differences
from pipeline.training.tensor_files import load_tensors, save_tensors

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


def settle(network: nn.Module, observations: Tensor) -> None:
    """Set batch normalisation's running statistics from observations; end in evaluation mode.

    For methods that train in evaluation mode, where the statistics of a fresh network would stay
    at their initial values. The observations are on the network's device.
    """
    normalising = [each for each in network.modules() if isinstance(each, nn.BatchNorm2d)]
    for layer in normalising:
        layer.reset_running_stats()
        layer.momentum = None  # The mean over all batches, weighted equally.
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
    """Write the weights of a policy and the shape of its network, atomically."""
    save_tensors(path, tensors, {"network": json.dumps(asdict(spec), sort_keys=True)})


def load_policy(
    path: Path,
    spec: NetworkSpec,
    device: torch.device | str = "cpu",
    make: Callable[[NetworkSpec], nn.Module] = Network,
) -> NetworkPolicy:
    """Return the policy of a file.

    Args:
        path: A file that `save_policy` wrote.
        spec: The shape of the network that is expected.
        device: The device to compute on.
        make: Returns the network, with any weights: `Learner.make` of the method.

    Raises:
        DatasetError: There is no such file, or it holds the policy of another network.
    """
    try:
        tensors, metadata = load_tensors(path, device)
        actual = json.loads(metadata.get("network", "{}"))
    except FileNotFoundError as error:
        raise DatasetError(f"{path} is not there: stages=[train] makes it") from error
    except (OSError, SafetensorError, ValueError) as error:
        reason = one_line(error)
        raise DatasetError(
            f"{path} cannot be read: {reason}; remove it, and stages=[train] makes it anew"
        ) from error
    differing = differences(actual, asdict(spec))
    if differing:
        raise DatasetError(f"{path} is a policy with {differing}")
    network = make(spec).to(device)
    try:
        network.load_state_dict(tensors)
    except RuntimeError as error:
        raise DatasetError(
            f"{path} is not a policy of this network: {one_line(error):.300}"
        ) from error
    return NetworkPolicy(network)

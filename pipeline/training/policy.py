"""Save and load the policy of a run: its weights as safetensors, a format that cannot hold code."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import Tensor, nn

from labyrinth_core.data.errors import MALFORMED, DatasetError, one_line
from labyrinth_core.data.storage import write_bytes
from labyrinth_core.policies.networks.acting import NetworkPolicy
from labyrinth_core.policies.networks.network import Network
from labyrinth_core.policies.spec import NetworkSpec
from pipeline.machinery.artifact import differences

INSTEAD = "choose another run_dir"


def save_tensors(path: Path, tensors: Mapping[str, Tensor], metadata: dict[str, str]) -> None:
    """Write tensors and texts into one safetensors file, atomically."""
    # Cloned because the format cannot express weights that networks share.
    owned = {name: tensor.detach().clone().contiguous() for name, tensor in tensors.items()}
    write_bytes(path, save(owned, metadata))


def load_tensors(
    path: Path, text: str, device: torch.device | str = "cpu"
) -> tuple[dict[str, Tensor], dict[str, Any]]:
    """Return the tensors of a file, and the value of its metadata entry `text`, parsed from JSON.

    Raises:
        DatasetError: The file does not exist, or cannot be read.
    """
    try:
        with safe_open(path, framework="pt", device=str(device)) as file:
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
            return tensors, json.loads((file.metadata() or {})[text])
    except FileNotFoundError as error:
        raise DatasetError(f"{path} does not exist: stages=train makes it") from error
    except (OSError, SafetensorError, *MALFORMED) as error:
        reason = f"{path} cannot be read: {one_line(error)}"
        raise DatasetError(f"{reason}; remove it to start again with stages=train") from error


def save_policy(path: Path, tensors: dict[str, Tensor], spec: NetworkSpec) -> None:
    """Write the weights of a policy and the specification of its network, atomically."""
    save_tensors(path, tensors, {"network": json.dumps(asdict(spec), sort_keys=True)})


def read_policy(
    path: Path,
    spec: NetworkSpec,
    device: torch.device | str = "cpu",
    make: Callable[[NetworkSpec], nn.Module] = Network,
) -> NetworkPolicy:
    """Load a policy from a file.

    Args:
        path: A file that `save_policy` wrote.
        spec: The network that the file is expected to hold.
        device: The device to compute on.
        make: Builds the network, whose weights are then replaced: `Learner.make` of the method.

    Raises:
        DatasetError: The file does not exist, or holds the policy of another network.
    """
    tensors, actual = load_tensors(path, "network", device)
    require_same(f"{path} is a policy", actual, asdict(spec))
    network = make(spec).to(device)
    try:
        network.load_state_dict(tensors)
    except RuntimeError as error:
        reason = f"{path} is not a policy of this network"
        raise DatasetError(f"{reason}: {one_line(error):.300}") from error
    return NetworkPolicy(network)


def require_same(
    thing: str, actual: Mapping[str, Any], required: Mapping[str, Any], advice: str = ""
) -> None:
    """Raise a DatasetError that lists how `actual` differs from `required`, if it does."""
    if differing := differences(options_of(actual), options_of(required)):
        raise DatasetError(f"{thing} with {differing}{advice}")


def options_of(description: Mapping[str, Any]) -> dict[str, Any]:
    """Return a run's description with each setting under the name of its option, `method.NAME`."""
    options = {name: value for name, value in description.items() if name != "settings"}
    settings = description.get("settings", {})
    return options | {f"method.{name}": value for name, value in settings.items()}

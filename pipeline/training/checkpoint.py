"""The weights of a run as safetensors, a format that cannot hold code: its policy, its checkpoint.

From a checkpoint an interrupted run continues exactly. It is one file: tensors and arrays are its
entries, and everything else is JSON in its header, with a SHA-256 of both. The file is replaced
atomically, so that weights, optimizer states, random states and history always belong together.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
from safetensors.torch import save as to_bytes
from torch import Tensor, nn
from torch.optim import Optimizer

from labyrinth_core.errors import DatasetError, one_line
from labyrinth_core.learning import Learner, NetworkSpec
from labyrinth_core.policies import read_tensors
from labyrinth_core.storage import File
from pipeline.config import ConfigError
from pipeline.training.identity import require_same, without_place

INSTEAD = "choose another run_dir"

Tensors = dict[str, Tensor]


@dataclass
class Progress:
    """The progress of a run."""

    epoch: int = 0
    seconds: float = 0.0
    """The training time, without interruptions."""
    history: list[dict[str, float]] = field(default_factory=list)
    """The metrics of each epoch."""
    best: dict[str, float] | None = None
    """The metrics of the epoch whose policy is kept."""
    stale: int = 0
    """The number of evaluations since the best SR on validation last rose."""
    weights: Tensors = field(default_factory=dict)
    """The weights of the policy that is kept."""


def save(path: Path, learner: Learner, progress: Progress, identity: Mapping[str, Any]) -> None:
    """Write a checkpoint atomically, into a folder that is made for it if it does not exist.

    Only a run with the same identity can continue from it.
    """
    tensors, plain = state_of(learner)
    tensors |= {f"best/{name}": tensor for name, tensor in progress.weights.items()}
    tensors["random/cpu"] = torch.get_rng_state()
    device = learner.problem.device
    if device.type != "cpu":
        tensors[f"random/{device.type}"] = torch.get_device_module(device).get_rng_state()
    done = {name: value for name, value in vars(progress).items() if name != "weights"}
    rng = learner.problem.rng.bit_generator.state
    state = {"learner": plain, "progress": done, "rng": rng, "run": dict(identity)}
    text = json.dumps(state)
    path.parent.mkdir(parents=True, exist_ok=True)
    save_tensors(path, tensors, {"state": text, "sha256": _digest(tensors, text)})


def load(path: Path, learner: Learner, identity: Mapping[str, Any]) -> Progress:
    """Restore a learner and the random states from a checkpoint; return the run's progress.

    Raises:
        DatasetError: The file cannot be read, or belongs to another run.
    """
    tensors, state = _read_checkpoint(path)
    advice = f": {INSTEAD}, or give overwrite=true to start again"
    told, there = f"{path} belongs to a run", without_place(state["run"])
    require_same(told, there, without_place(identity), advice)
    restore(learner, tensors, state["learner"])
    learner.problem.rng.bit_generator.state = state["rng"]
    torch.set_rng_state(tensors["random/cpu"])
    kind = learner.problem.device.type
    if kind != "cpu" and f"random/{kind}" in tensors:
        torch.get_device_module(kind).set_rng_state(tensors[f"random/{kind}"])
    return Progress(**state["progress"], weights=_within(tensors, "best"))


def identity_in(path: Path) -> dict[str, Any]:
    """Return the identity of the run that wrote a checkpoint, `without_place`.

    Raises:
        DatasetError: The file cannot be read.
    """
    _, state = _read_checkpoint(path)
    return without_place(state["run"])


def state_of(learner: Learner) -> tuple[Tensors, dict[str, Any]]:
    """Return the learner's state: its tensors, and its values that fit into JSON.

    Raises:
        ConfigError: An attribute has a type that checkpoints do not support.
    """
    tensors: Tensors = {}
    plain: dict[str, Any] = {}
    for name, value in _attributes(learner):
        if isinstance(value, nn.Module):
            tensors |= {f"{name}/{key}": each for key, each in value.state_dict().items()}
        elif isinstance(value, Optimizer):
            state = value.state_dict()
            plain[name] = state["param_groups"]
            for number, moments in state["state"].items():
                tensors |= {f"{name}/{number}/{key}": each for key, each in moments.items()}
        elif isinstance(value, np.ndarray) and value.dtype.kind in "biuf":
            tensors[name] = torch.as_tensor(value)
        elif isinstance(value, int | float):
            plain[name] = value
        else:
            raise ConfigError(
                f"the method's attribute {name} has the type {type(value).__name__}, which a "
                "checkpoint cannot save: it saves networks, optimizers, arrays and numbers"
            )
    return tensors, plain


def restore(learner: Learner, tensors: Tensors, plain: dict[str, Any]) -> None:
    """Set a learner's state to one that `state_of` returned."""
    for name, value in _attributes(learner):
        if isinstance(value, nn.Module):
            value.load_state_dict(_within(tensors, name))
        elif isinstance(value, Optimizer):
            state: dict[int, Tensors] = {}
            for key, tensor in _within(tensors, name).items():
                number, _, moment = key.partition("/")
                state.setdefault(int(number), {})[moment] = tensor
            value.load_state_dict({"state": state, "param_groups": plain[name]})
        elif isinstance(value, np.ndarray):
            setattr(learner, name, tensors[name].numpy())
        else:
            setattr(learner, name, plain[name])


def _attributes(learner: Learner) -> Iterator[tuple[str, Any]]:
    for name, value in sorted(vars(learner).items()):
        if name not in ("problem", "settings"):
            yield name, value


def _within(tensors: Tensors, name: str) -> Tensors:
    """Return the tensors whose names begin with `name/`, without that prefix."""
    start = f"{name}/"
    return {key[len(start) :]: each for key, each in tensors.items() if key.startswith(start)}


def save_tensors(path: Path, tensors: Mapping[str, Tensor], metadata: dict[str, str]) -> None:
    """Write tensors and texts into one safetensors file, atomically."""
    # Cloned because the format cannot express weights that networks share.
    owned = {name: tensor.detach().clone().contiguous() for name, tensor in tensors.items()}
    File(path).write_bytes(to_bytes(owned, metadata))


def _digest(tensors: Mapping[str, Tensor], text: str) -> str:
    """Return the SHA-256 of tensors, with their names, shapes and dtypes, and of a text."""
    digest = hashlib.sha256(text.encode())
    for name, tensor in sorted(tensors.items()):
        digest.update(f"{name} {tensor.dtype} {tuple(tensor.shape)}\n".encode())
        digest.update(tensor.detach().cpu().contiguous().flatten().view(torch.uint8).numpy().data)
    return digest.hexdigest()


def _read_checkpoint(path: Path) -> tuple[Tensors, dict[str, Any]]:
    """Return the tensors and the state in a checkpoint.

    Raises:
        DatasetError: The file cannot be read, or is damaged.
    """
    with _explained(path):
        tensors, texts = read_tensors(path)
        if texts.get("sha256") != _digest(tensors, texts.get("state", "")):
            raise ValueError("it is damaged: its sha256 is not the one in its header")
        return tensors, _object(texts, "state")


def _object(texts: Mapping[str, str], name: str) -> dict[str, Any]:
    """Return the JSON object in a text of a file of tensors; raise ValueError without one."""
    content = json.loads(texts.get(name, "null"))
    if not isinstance(content, dict):
        raise ValueError(f"its header has no {name}")
    return content


@contextmanager
def _explained(path: Path) -> Iterator[None]:
    """Turn the errors of reading a file of tensors into a DatasetError."""
    try:
        yield
    except FileNotFoundError as error:
        raise DatasetError(f"{path} does not exist: stages=train makes it") from error
    except (OSError, ValueError, RecursionError) as error:
        reason = f"{path} cannot be read: {one_line(error):.300}"
        raise DatasetError(f"{reason}; remove it to start again with stages=train") from error


def save_policy(path: Path, tensors: Tensors, spec: NetworkSpec) -> None:
    """Write the weights of a policy and the specification of its network, atomically."""
    save_tensors(path, tensors, {"network": json.dumps(asdict(spec), sort_keys=True)})


def read_policy(
    path: Path,
    method: type[Learner],
    settings: Any,
    spec: NetworkSpec,
    device: torch.device | str = "cpu",
) -> Any:
    """Load the policy of a method from a file, as `Learner.player` takes it.

    Args:
        path: A file that `save_policy` wrote.
        method: The method, which makes the network.
        settings: The settings of the method.
        spec: The network that the file is expected to hold.
        device: The device to compute on.

    Raises:
        DatasetError: The file does not exist, or holds the policy of another network.
    """
    with _explained(path):
        tensors, texts = read_tensors(path)
        actual = _object(texts, "network")
    require_same(f"{path} is a policy", actual, asdict(spec))
    try:
        return method.trained(tensors, spec, settings, device)
    except RuntimeError as error:
        reason = f"{path} is not a policy of this network"
        raise DatasetError(f"{reason}: {one_line(error):.300}") from error

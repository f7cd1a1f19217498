"""The state of a training run in one file, so that a run that was killed goes on exactly.

Tensors and arrays are entries of a safetensors file, all else is one JSON text in its header. One
file is replaced as a whole, so weights, optimizers, randomness and history always fit together.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
from safetensors import SafetensorError, safe_open
from torch import Tensor, nn
from torch.optim import Optimizer

from labyrinth_core.data.errors import DatasetError, one_line
from pipeline.training.methods.method import Learner
from pipeline.training.tensor_files import save_tensors

Tensors = dict[str, Tensor]


@dataclass
class Progress:
    """How far a run is."""

    epoch: int = 0
    seconds: float = 0.0
    """Spent on training, before and after interruptions."""
    history: list[dict[str, float]] = field(default_factory=list)
    """The figures of each epoch."""
    best: dict[str, float] | None = None
    """Those of the epoch whose policy is kept."""
    stale: int = 0
    """Evaluations since validation SR was last better than ever before."""
    weights: Tensors = field(default_factory=dict)
    """Of the policy that is kept."""


def save(path: Path, learner: Learner, progress: Progress, identity: Mapping[str, Any]) -> None:
    """Write a checkpoint, all or nothing.

    Args:
        path: Of the file.
        learner: Its state, and that of the randomness it draws from.
        progress: So far.
        identity: What the run is; another one will not go on from here.
    """
    tensors, plain = state_of(learner)
    tensors |= {f"best/{name}": tensor for name, tensor in progress.weights.items()}
    tensors |= _random_states(learner)
    told = asdict(progress)
    del told["weights"]
    rng = learner.problem.rng.bit_generator.state
    state = {"learner": plain, "progress": told, "rng": rng, "run": dict(identity)}
    save_tensors(path, tensors, {"state": json.dumps(state)})


def load(path: Path, learner: Learner, identity: Mapping[str, Any]) -> Progress:
    """Bring a learner to the state of a checkpoint and return how far it was.

    Raises:
        DatasetError: The file cannot be read, or is of another run.
    """
    device = str(learner.problem.observations.device)
    try:
        with safe_open(path, framework="pt", device="cpu") as file:
            state = json.loads((file.metadata() or {})["state"])
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    except (OSError, SafetensorError, KeyError, ValueError) as error:
        reason = one_line(error)
        raise DatasetError(f"{path} is no checkpoint: {reason}; remove it to begin anew") from error
    differing = differences(state["run"], identity)
    if differing:
        raise DatasetError(
            f"{path} is of a run with {differing}: choose another run_dir, or give overwrite=true "
            "to begin anew"
        )
    restore(learner, tensors, state["learner"])
    learner.problem.rng.bit_generator.state = state["rng"]
    torch.set_rng_state(tensors["random/cpu"])
    if "random/cuda" in tensors:
        torch.cuda.set_rng_state(tensors["random/cuda"], device)
    progress = Progress(**state["progress"])
    progress.weights = _within(tensors, "best")
    return progress


def differences(there: Mapping[str, Any], wanted: Mapping[str, Any]) -> str:
    """Return in words where what a run is differs from what it is to be; empty if nowhere."""
    there, wanted = _flat(there), _flat(wanted)
    return "; ".join(
        f"{name}={there.get(name)}, not {wanted.get(name)}"
        for name in {**wanted, **there}
        if there.get(name) != wanted.get(name)
    )


def _flat(identity: Mapping[str, Any]) -> dict[str, Any]:
    """Return what a run is, its method's settings by the names that they have as options."""
    settings = identity.get("settings", {})
    rest = {name: value for name, value in identity.items() if name != "settings"}
    return rest | {f"method.{name}": value for name, value in settings.items()}


def state_of(learner: Learner) -> tuple[Tensors, dict[str, Any]]:
    """Return all that a learner changes, as tensors and as plain values.

    Raises:
        TypeError: One of its attributes is of a kind that is not kept.
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
        elif isinstance(value, np.ndarray):
            tensors[name] = torch.as_tensor(value)
        elif isinstance(value, int | float):
            plain[name] = value
        else:
            raise TypeError(f"{name} is a {type(value).__name__}, which a checkpoint does not keep")
    return tensors, plain


def restore(learner: Learner, tensors: Tensors, plain: dict[str, Any]) -> None:
    """Give a learner the state that `state_of` returned."""
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
    """Return the tensors under a name, called by what comes after it."""
    return {
        key.removeprefix(f"{name}/"): tensor
        for key, tensor in tensors.items()
        if key.startswith(f"{name}/")
    }


def _random_states(learner: Learner) -> Tensors:
    device = learner.problem.observations.device
    states = {"random/cpu": torch.get_rng_state()}
    if device.type == "cuda":
        states["random/cuda"] = torch.cuda.get_rng_state(device)
    return states

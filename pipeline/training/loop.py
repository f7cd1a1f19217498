"""The training loop of all methods: train an epoch, evaluate, keep the best policy, continue.

From a checkpoint an interrupted run continues exactly. It is one file in the safetensors format,
which cannot hold code: tensors and arrays are its entries, and everything else is JSON in its
header, with a SHA-256 of both. The file is replaced atomically, so that weights, optimizer states,
random states and history always belong together.
"""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from math import inf, isfinite
from pathlib import Path
from typing import Any

import numpy as np
import torch
from safetensors.torch import save as to_bytes
from torch import Tensor, nn
from torch.optim import Optimizer

from labyrinth_core.errors import DatasetError, one_line
from labyrinth_core.learning import Learner
from labyrinth_core.policies import read_tensors
from labyrinth_core.storage import File
from pipeline.config import ConfigError, check
from pipeline.training.identity import require_same, without_place

CHECKPOINT_SECONDS = 30.0
"""The minimum time between two checkpoints."""
INSTEAD = "choose another run_dir"

Tensors = dict[str, Tensor]


@dataclass(frozen=True)
class Protocol:
    """When training ends."""

    evaluate_every: int | None = None
    """The number of epochs between evaluations; None for the method's own."""
    patience: float = inf
    """The number of evaluations without a better validation success rate that end training."""


PROTOCOLS = {
    "default": Protocol(),
    "paper": Protocol(evaluate_every=10, patience=5),
    "authors": Protocol(),
}
"""`default` and `paper` keep the policy with the best success rate on validation.

`default` trains for the method's whole budget, and shrinks pictures without losing walls. `paper`
resizes the authors' thin walls as they do, without antialiasing, so that most walls vanish. It
stops training like the authors' public script for BC: after five evaluations on the validation
labyrinths, ten epochs apart, without a better success rate, or after the method's epochs (a
thousand in that script). Here the other methods follow the same rule. `authors` is for the six
methods of the authors' later code, which have their own settings and selection, and are in
scripts/studies/methods/authors.
"""


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


def fit(
    learner: Learner,
    judge: Callable[[Learner], dict[str, float]],
    protocol: Protocol,
    path: Path,
    identity: Mapping[str, Any],
    report: Callable[[Progress], None],
    checkpoint_seconds: float = CHECKPOINT_SECONDS,
) -> Progress:
    """Train until the last epoch or early stopping, and return the run's progress.

    The policy is kept that is best by `Learner.is_better`.

    Args:
        learner: A fresh learner.
        judge: Returns the success rates of a learner's policy, among them `validation_sr`; called
            every `evaluate_every` epochs, and after the last epoch.
        protocol: When to stop early.
        path: The checkpoint; if it exists, training continues from it.
        identity: Everything that determines the run's weights.
        report: Called after every epoch.
        checkpoint_seconds: The minimum time between two checkpoints; they are written after epochs.

    Raises:
        ConfigError: A metric is not finite, the method returns no loss, or its state cannot be
            saved in a checkpoint. The last checkpoint stays unchanged.
    """
    state_of(learner)
    progress = load_checkpoint(path, learner, identity) if path.exists() else Progress()
    epochs = learner.settings.epochs
    every = protocol.evaluate_every or learner.settings.evaluate_every
    saved = time.perf_counter()
    began = saved - progress.seconds
    while progress.epoch < epochs and progress.stale < protocol.patience:
        if learner.problem.renewed is not None:
            learner.renew(learner.problem.renewed(learner.problem, progress.epoch))
        figures = _plain(learner.epoch())
        progress.epoch += 1
        for name, value in figures.items():
            check(
                isfinite(value),
                f"method.learning_rate={learner.settings.learning_rate}: {name} is {value} in "
                f"epoch {progress.epoch}, so that training cannot continue; give a lower rate. "
                "Existing files are unchanged",
            )
        if progress.epoch == 1:
            state_of(learner)  # Fail now, not when the first checkpoint is due.
        if progress.epoch % every == 0 or progress.epoch == epochs:
            figures |= judge(learner)
        now = time.perf_counter()
        progress.seconds = now - began
        row = {"epoch": progress.epoch, "seconds": round(progress.seconds, 3)} | figures
        progress.history.append(row)
        if "validation_sr" in figures:
            _select(learner, progress)
        if now - saved >= checkpoint_seconds:
            save_checkpoint(path, learner, progress, identity)
            saved = now
        report(progress)
    return progress


def _select(learner: Learner, progress: Progress) -> None:
    """Keep the current policy if it is the best so far."""
    figures, best = progress.history[-1], progress.best
    higher = best is None or figures["validation_sr"] > best["validation_sr"]
    progress.stale = 0 if higher else progress.stale + 1
    if best is None or learner.is_better(figures, best):
        progress.best = figures
        state = learner.policy.state_dict()
        progress.weights = {name: tensor.detach().clone() for name, tensor in state.items()}


def _plain(figures: Any) -> dict[str, float]:
    """Return the metrics of an epoch as Python numbers.

    Raises:
        ConfigError: `figures` is not a dictionary of numbers, or has no loss.
    """
    try:
        plain = {
            str(name): value if isinstance(value, int | float) else float(value)
            for name, value in figures.items()
        }
        plain["loss"] += 0
    except (AttributeError, LookupError, RuntimeError, TypeError, ValueError) as error:
        returned = " ".join(repr(figures).split())
        raise ConfigError(
            f"the method's epoch returned {returned:.100}: it has to return a dictionary of "
            'numbers with the loss, such as {"loss": 0.5}'
        ) from error
    return plain


def save_checkpoint(
    path: Path, learner: Learner, progress: Progress, identity: Mapping[str, Any]
) -> None:
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


def load_checkpoint(path: Path, learner: Learner, identity: Mapping[str, Any]) -> Progress:
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
    try:
        tensors, texts = read_tensors(path)
        text = texts.get("state", "null")
        if texts.get("sha256") != _digest(tensors, text):
            raise ValueError("it is damaged: its sha256 is not the one in its header")
        state = json.loads(text)
        if not isinstance(state, dict):
            raise ValueError("its header has no state")
    except (OSError, ValueError, RecursionError) as error:
        reason = f"{path} cannot be read: {one_line(error):.300}"
        raise DatasetError(f"{reason}; remove it to start again with stages=train") from error
    return tensors, state

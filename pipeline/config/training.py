"""The options of training: their schema, their checks, and the frozen object made from them.

Torch is not imported here, so that `python run.py --help` stays quick.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any

from pipeline.config.errors import check, check_choice, listed

ENCODERS = {"cnn": "image", "resnet18": "image", "mlp": "vector"}
"""Encoder -> what it looks at."""

IMAGE_SIZE = 64
"""Pixels on each side of what the baselines look at (supplement, section 1)."""

OWN_NETWORKS = ("planner",)
"""Methods with a network of their own, for pictures, whatever `encoder` says."""

DEVICES = ("auto", "cpu", "cuda")

POOL_STRIDES = (1, 2)

MAX_THREADS = 1_000


@dataclass(frozen=True)
class Protocol:
    """How pictures are shrunk, and when training ends."""

    resize: str
    """As `data.observations.RESIZES` has it: `area` keeps every wall, `original` does not."""
    evaluate_every: int | None = None
    """Epochs after which the policy is tried; None: as the method has it."""
    patience: int | None = None
    """Evaluations without a better validation SR after which training stops; None: never."""


PROTOCOLS = {
    "default": Protocol(resize="area"),
    "paper": Protocol(resize="original", evaluate_every=10, patience=5),
}
"""Both keep the policy with the best SR on validation.

`default` spends the whole budget, and shrinks pictures without losing walls. `paper` has the
authors' thin walls and their resize without antialiasing, so that most walls vanish; and it stops
as their public training script does: the policy is tried on the validation labyrinths every ten
epochs, and training ends after five times without a better success rate, or else after the
method's epochs (a thousand there). That script trains BC; where the sources are silent, for the
other methods, the same rule is used.
"""


@dataclass
class TrainingConfig:
    """The schema of the options; `TRAINING_OPTIONS` explains each field."""

    method: dict[str, Any] = field(default_factory=lambda: {"name": "bc"})
    encoder: str = "cnn"
    pool_stride: int = 1
    observation: str = "image"
    protocol: str = "default"
    dataset: str | None = None
    revision: str | None = None
    run_dir: str = "runs"
    results_dir: str = "results"
    device: str = "auto"
    threads: int | None = None
    tensorboard: bool = False


TRAINING_OPTIONS = {
    "method": "bc, dagger, gail, bco, sqil, iupe or planner; its own settings as method.epochs=...",
    "encoder": "network that looks at an observation: "
    + ", ".join(ENCODERS)
    + "; planner has its own",
    "pool_stride": "of the first pooling of resnet18: 1 as in the paper, or 2",
    "observation": "what is learnt from: image, or vector (for the encoder mlp)",
    "protocol": "default, or paper for the original's resize and stopping rule",
    "dataset": "id on the Hub, such as user/labyrinth, or another folder than data_dir",
    "revision": "branch, tag or commit of the dataset on the Hub",
    "run_dir": "folder of the runs; each size and task is a folder in it",
    "results_dir": "folder of the tables, and of the evaluations that they are made of",
    "device": "where networks are computed: " + ", ".join(DEVICES),
    "threads": "of the processor, for networks (all cores)",
    "tensorboard": "write the learning curves for TensorBoard, too",
}
"""What each option means, as `python run.py --help` and the README say it."""


@dataclass(frozen=True)
class TrainingOptions:
    """What to train, on what, and where, checked; the settings of the method are checked by it."""

    method: str
    settings: Mapping[str, Any]
    """Of the method, as they were given."""
    encoder: str
    pool_stride: int
    observation: str
    protocol: str
    source: str
    """Folder or id on the Hub."""
    revision: str | None
    run_dir: Path
    results_dir: Path
    device: str
    threads: int | None
    tensorboard: bool
    seed: int

    @property
    def name(self) -> str:
        """The name of the run's folder, such as `bc-cnn-seed0` or `iupe-resnet18-seed2-paper`."""
        parts = [self.method, f"seed{self.seed}"]
        parts[1:1] = [self.encoder] * (self.encoder != self.method)
        parts += [f"stride{self.pool_stride}"] * (self.pool_stride != 1)
        parts += [self.protocol] * (self.protocol != "default")
        return "-".join(parts)

    def folder(self, config_name: str) -> Path:
        """Return where the run lies, for a dataset's config such as `5x5`."""
        return self.run_dir / config_name / self.name

    @property
    def what(self) -> dict[str, Any]:
        """All that determines the weights, but for the dataset and the method's settings."""
        names = ("method", "encoder", "pool_stride", "observation", "protocol", "seed")
        return {name: getattr(self, name) for name in names}


def resolve_training(config: TrainingConfig, data_dir: str, seed: int) -> TrainingOptions:
    """Return the options of a configuration.

    Raises:
        ConfigError: One is impossible.
    """
    settings = dict(config.method)
    name = str(settings.pop("name", ""))
    check(
        re.fullmatch(r"[a-z][a-z0-9_]*", name, re.ASCII) is not None,
        f"method.name={name}: give the name of a method, such as bc",
    )
    check_choice("encoder", config.encoder, ENCODERS)
    check_choice("pool_stride", config.pool_stride, POOL_STRIDES)
    check_choice("observation", config.observation, sorted(set(ENCODERS.values())))
    check_choice("protocol", config.protocol, PROTOCOLS)
    check_choice("device", config.device, DEVICES)
    fitting = [encoder for encoder, sees in ENCODERS.items() if sees == config.observation]
    check(
        config.encoder in fitting,
        f"encoder={config.encoder} looks at observation={ENCODERS[config.encoder]}: for "
        f"observation={config.observation} choose one of {listed(fitting)}",
    )
    check(
        name not in OWN_NETWORKS or config.observation == "image",
        f"method={name} learns from pictures: leave observation=image",
    )
    check(
        config.threads is None or 1 <= config.threads <= MAX_THREADS,
        f"threads={config.threads}: give a number from 1 to {MAX_THREADS:,}",
    )
    check(config.results_dir.strip() != "", "results_dir is empty: give a folder")
    return TrainingOptions(
        method=name,
        settings=MappingProxyType(settings),
        encoder=name if name in OWN_NETWORKS else config.encoder,
        pool_stride=config.pool_stride,
        observation=config.observation,
        protocol=config.protocol,
        source=data_dir if config.dataset is None else config.dataset,
        revision=config.revision,
        run_dir=Path(config.run_dir).expanduser(),
        results_dir=Path(config.results_dir).expanduser(),
        device=config.device,
        threads=config.threads,
        tensorboard=config.tensorboard,
        seed=seed,
    )

"""The interface of a method: its settings, and a learner that trains one epoch at a time.

A method is a module of this package with two classes, `Settings` and `Method`, and a file of the
same name in `conf/method/`. docs/new-method.md shows an example.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import Field, dataclass, field, fields
from functools import cached_property
from importlib import import_module
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional
from torch.optim import Adam

from labyrinth_core.evaluation.labyrinth_arrays import LabyrinthArrays
from pipeline.config.errors import ConfigError
from pipeline.training.methods.relabelling import ExampleSampler
from pipeline.training.networks.network import ACTIONS, Network, NetworkSpec
from pipeline.training.policy import outputs_of
from pipeline.training.steps import Steps

LEARNING_RATE = 5e-4
"""The learning rate of Adam, for all methods (supplement, section 3)."""


def setting(default: float, low: float = 0, high: float = float("inf")) -> Any:
    """Return the field of a setting: its default, and the least and greatest value allowed.

    One whose default is True or False is either, and has no least and greatest value.
    """
    return field(default=default, metadata={"low": low, "high": high})


@dataclass(frozen=True)
class BaseSettings:
    """What every method lets one choose; its own settings are made by `setting`, too."""

    epochs: int = setting(100, 1)
    """How often `Learner.epoch` is called."""
    evaluate_every: int = setting(2, 1)
    """Epochs after which the policy is tried on train and validation."""
    batch_size: int = setting(64, 2)
    """Of a gradient step."""
    learning_rate: float = setting(LEARNING_RATE, 0)


@dataclass(frozen=True, eq=False)
class Problem:
    """Everything that a method may learn from and compute with."""

    arrays: LabyrinthArrays
    """The labyrinths of the split train, and of no other."""
    observations: Tensor
    """The observations of `arrays`, on the device, shape (S, ...)."""
    demonstrations: Steps
    exploration: Callable[[], Steps]
    """Returns the steps of the random policy; raises DatasetError if the dataset has none."""
    spec: NetworkSpec
    rng: np.random.Generator
    """The source of all randomness but that of weights and dropout, which is torch's."""

    @property
    def device(self) -> torch.device:
        """The device to compute on."""
        return self.observations.device

    @cached_property
    def examples(self) -> ExampleSampler:
        """The source of pictures drawn from the demonstrations, as they are or relabelled."""
        return ExampleSampler(self.arrays, self.demonstrations)


class Learner(ABC):
    """A method during training.

    Its attributes are its state, which checkpoints keep: networks, optimizers, arrays and numbers.
    Nothing else may change between epochs.
    """

    policy: nn.Module
    """The network that is evaluated and kept; its highest output is the action."""

    def __init__(self, problem: Problem, settings: Any) -> None:
        self.problem = problem
        self.settings = settings
        self.policy = self.make(problem.spec, settings).to(problem.device)
        self.optimizer = self.adam(self.policy)

    @classmethod
    def make(cls, spec: NetworkSpec, settings: Any) -> nn.Module:  # noqa: ARG003
        """Return a fresh network for the policy; some methods have another one than `Network`."""
        return Network(spec)

    @abstractmethod
    def epoch(self) -> dict[str, float]:
        """Train for an epoch; return figures to show and keep, among them `loss`."""

    def network(self, outputs: int = ACTIONS, frames: int = 1) -> Network:
        """Return a fresh network with the run's encoder; see `Network`."""
        return Network(self.problem.spec, outputs, frames).to(self.problem.device)

    def adam(self, network: nn.Module) -> Adam:
        """Return an optimizer for a network."""
        return Adam(network.parameters(), lr=self.settings.learning_rate)

    def descend(self, optimizer: Adam, loss: Tensor) -> None:
        """Take a gradient step."""
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()

    def tensor(self, array: NDArray[Any]) -> Tensor:
        """Return an array as a tensor on the device."""
        return torch.as_tensor(array, device=self.problem.device)

    def see(self, *states: NDArray[np.int64]) -> Tensor:
        """Return the observations of states; of several, concatenated along the last axis."""
        return torch.cat([self.problem.observations[self.tensor(each)] for each in states], -1)

    def outputs(self, network: nn.Module) -> Tensor:
        """Return a network's outputs in all states, in evaluation mode, shape (S, outputs)."""
        return outputs_of(network, self.problem.observations)

    def batches(self, count: int) -> list[NDArray[np.int64]]:
        """Return the numbers below `count` in random order, divided into batches."""
        order = self.problem.rng.permutation(count)
        return np.array_split(order, -(-count // self.settings.batch_size))

    def clone(
        self,
        network: nn.Module,
        optimizer: Adam,
        states: tuple[NDArray[np.int64], ...],
        labels: NDArray[np.int64],
    ) -> float:
        """Fit a classifier to labels in one pass over them; return the mean cross-entropy.

        Args:
            network: The classifier, which is set to training mode.
            optimizer: The classifier's optimizer.
            states: Numbers of states, shape (N,); several such arrays for a network that sees
                several states at once.
            labels: The classes, shape (N,).
        """
        network.train()
        total = 0.0
        for batch in self.batches(len(labels)):
            scores = network(self.see(*(each[batch] for each in states)))
            loss = functional.cross_entropy(scores, self.tensor(labels[batch]))
            self.descend(optimizer, loss)
            total += loss.item() * len(batch)
        return total / len(labels)


def find(name: str, values: Mapping[str, Any]) -> tuple[type[Learner], BaseSettings]:
    """Return a method and its settings.

    Args:
        name: The name of the method's module in this package, such as `bc`.
        values: The values of some settings; the others have their defaults.

    Raises:
        ConfigError: There is no such method or setting, or a value that is not allowed.
    """
    module_name = f"{__package__}.{name}"
    try:
        module = import_module(module_name)
    except ModuleNotFoundError as error:
        if error.name != module_name:
            raise
        module = None
    method, settings = getattr(module, "Method", None), getattr(module, "Settings", None)
    if method is None or settings is None:
        raise ConfigError(f"method={name}: pipeline/training/methods has no method of that name")
    return method, settings_of(settings, values)


def settings_of(cls: type[BaseSettings], values: Mapping[str, Any]) -> BaseSettings:
    """Return settings with the given values, the others being the defaults.

    Raises:
        ConfigError: There is no such setting, or the value is not allowed.
    """
    known = {each.name: each for each in fields(cls)}
    for name, value in values.items():
        if name not in known:
            raise ConfigError(f"method.{name} is no option: choose from [{', '.join(known)}]")
        _check(known[name], value)
    return cls(**values)


def _check(known: Field[Any], value: object) -> None:
    if isinstance(known.default, bool):
        if not isinstance(value, bool):
            raise ConfigError(f"method.{known.name}={value}: give true or false")
        return
    low, high = known.metadata["low"], known.metadata["high"]
    kinds = (int, float) if isinstance(known.default, float) else (int,)
    if not isinstance(value, kinds) or isinstance(value, bool) or not low <= value <= high:
        kind = "a whole number" if kinds == (int,) else "a number"
        limit = "or more" if high == float("inf") else f"to {high}"
        raise ConfigError(f"method.{known.name}={value}: give {kind}, {low} {limit}")

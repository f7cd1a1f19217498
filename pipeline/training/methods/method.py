"""The interface of a method: its settings, and a learner that trains one epoch at a time.

A method is a module in one of the packages `METHODS`, with two classes, `Settings` and `Method`,
and a file of the same name in `conf/method/`. docs/new-method.md shows an example.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import MISSING, dataclass, fields
from functools import cached_property
from importlib import import_module
from importlib.util import find_spec
from math import inf
from typing import Any, ClassVar

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional
from torch.nn.utils import clip_grad_norm_
from torch.optim import Adam

from labyrinth_core.evaluation.answers import Policy
from labyrinth_core.evaluation.labyrinth_arrays import LabyrinthArrays
from labyrinth_core.policies.networks.acting import outputs_of
from labyrinth_core.policies.networks.network import ACTIONS, Network
from labyrinth_core.policies.remembering import PictureMemory
from labyrinth_core.policies.spec import NetworkSpec
from pipeline.config.errors import ConfigError, check
from pipeline.config.option import check_options, frozen, option
from pipeline.config.training import (
    IMAGE_SIZE,
    METHODS,
    PROTOCOLS,
    settings_in,
    usual_settings,
)
from pipeline.training.methods.acting import Steps
from pipeline.training.methods.relabelling import ExampleSampler


def setting(meaning: str, *, at_least: float = 0, at_most: float = inf) -> Any:
    """Return the field that declares a setting, as `option` does; conf/method/ has the values."""
    return option(MISSING, meaning, at_least=at_least, at_most=at_most)


@dataclass(frozen=True)
class BaseSettings:
    """The settings of every method; a method declares its own by `setting` in the same way."""

    epochs: int = setting("number of calls of `Learner.epoch`", at_least=1)
    evaluate_every: int = setting(
        "number of epochs after which the policy is tried on train and validation", at_least=1
    )
    batch_size: int = setting("number of transitions in a gradient step", at_least=2)
    learning_rate: float = setting("learning rate of Adam (5e-4 in the supplement, section 3)")


@dataclass(frozen=True, eq=False)
class Problem:
    """Everything that a method may learn from and compute with."""

    arrays: LabyrinthArrays
    """The labyrinths of the split train, and of no other."""
    observations: Tensor
    """The observations of `arrays`, on the device, shape (S, ...). With memory, observations of the
    states of `demonstrations` follow."""
    demonstrations: Steps
    exploration: Callable[[], Steps]
    """Returns the steps of the random policy; raises DatasetError if the dataset has none."""
    spec: NetworkSpec
    rng: np.random.Generator
    """The source of all randomness except weights and dropout, for which torch's is used."""
    precision: str = "fp32"
    """One of `PRECISIONS`."""
    memory: PictureMemory | None = None
    """What makes the pictures of a policy that is shown all that it has seen in the episode."""

    @property
    def device(self) -> torch.device:
        """The device to compute on."""
        return self.observations.device

    def autocast(self) -> torch.autocast:
        """Return the context in which networks are trained, in the precision of the run.

        Weights are cast anew each time, since they change within the context.
        """
        enabled = self.precision == "bf16"
        return torch.autocast(self.device.type, torch.bfloat16, enabled, cache_enabled=False)

    @cached_property
    def examples(self) -> ExampleSampler:
        """The source of pictures drawn from the demonstrations, as they are or relabelled."""
        return ExampleSampler(self.arrays, self.memory)


class Learner(ABC):
    """A method during training.

    Its attributes are its state, which checkpoints keep: networks, optimizers, arrays and numbers.
    Nothing else may change between epochs.
    """

    policy: nn.Module
    """The network that is evaluated and kept; its highest output is the action."""
    selected_by: ClassVar[str] = "validation_sr"
    """The figure of which the policy that is kept has the highest value."""
    max_gradient: ClassVar[float] = inf
    """The norm to which the gradients of a step are clipped."""

    def __init__(self, problem: Problem, settings: Any) -> None:
        self.problem = problem
        self.settings = settings
        self.policy = self.make(problem.spec, settings).to(problem.device)
        self.optimizer = self.adam(self.policy)

    @classmethod
    def make(cls, spec: NetworkSpec, settings: Any) -> nn.Module:  # noqa: ARG003
        """Return a fresh network for the policy; a method may have another one than `Network`."""
        return Network(spec)

    @classmethod
    def image_size(cls, spec: NetworkSpec, settings: Any, height: int, width: int) -> int:  # noqa: ARG003
        """Return the pixels on each side of pictures of labyrinths of another size.

        Args:
            spec: The network, with the size of the labyrinths that it was trained on.
            settings: The settings of the method.
            height: The number of rows of the others.
            width: The number of columns.

        Raises:
            ConfigError: The policy cannot see labyrinths of that size.
        """
        return IMAGE_SIZE

    @classmethod
    def figures(
        cls,
        policy: Policy,  # noqa: ARG003
        train: LabyrinthArrays,  # noqa: ARG003
        validation: LabyrinthArrays,  # noqa: ARG003
    ) -> dict[str, float]:
        """Return further figures, besides success rates, of a policy tried during training."""
        return {}

    @classmethod
    def as_tried(cls, policy: Policy, arrays: LabyrinthArrays) -> dict[str, float]:  # noqa: ARG003
        """Return the figures of a policy by the protocol's own rules, if the protocol has rules."""
        return {}

    @classmethod
    def player(cls, policy: Policy, spec: NetworkSpec, settings: Any) -> Any:  # noqa: ARG003
        """Return the policy of a network as it acts, in any of the forms that `evaluate` takes.

        By default it is a function, which remembers nothing, so it is evaluated by look-ups. A
        method whose policy remembers returns an object with `reset(count)` and
        `act(observations)`, which is stepped both during training and in evaluation.

        Args:
            policy: The function of a network, from B observations to scores of shape (B, 4).
            spec: The network, with the size of the labyrinths that it acts in.
            settings: The settings of the method.
        """
        return policy

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
        if self.max_gradient < inf:
            clip_grad_norm_(optimizer.param_groups[0]["params"], self.max_gradient)
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


def require_square(what: str, height: int, width: int, advice: str = "") -> None:
    """Raise a ConfigError, which names what cannot see them, if labyrinths are not square."""
    check(
        height == width,
        f"size={height}x{width}: {what} needs as many rows as columns{advice}",
    )


def same_scale(spec: NetworkSpec, height: int, width: int) -> int:
    """Return the pixels on each side with which cells are as large as those trained on."""
    return round(IMAGE_SIZE * max(height, width) / max(spec.height, spec.width))


def find(
    name: str, values: Mapping[str, Any], protocol: str = "default"
) -> tuple[type[Learner], BaseSettings]:
    """Return a method and its settings.

    Args:
        name: The name of the method's module, such as `bc`.
        values: The values of some settings; the others are in the method's file in conf/method/.
        protocol: One of `PROTOCOLS`, which may have methods of its own.

    Raises:
        ConfigError: The method or a setting does not exist, or a value is not allowed.
    """
    own = PROTOCOLS[protocol].methods
    packages = [f"{METHODS[-1]}.{own}"] if own else METHODS
    names = [f"{package}.{name}" for package in packages]
    module: Any = next((import_module(each) for each in names if find_spec(each)), None)
    if not (hasattr(module, "Method") and hasattr(module, "Settings")):
        where = " and ".join(package.replace(".", "/") for package in packages)
        raise ConfigError(f"method={name}: no method of that name in {where}")
    method, settings = module.Method, module.Settings
    values = {**usual_settings(name, protocol), **settings_in(values)}
    known = {each.name for each in fields(settings)}
    check(
        not own or known >= values.keys(),
        f"protocol={protocol}: its methods have other settings, so give method={own}/{name} alone",
    )
    for each in fields(settings):
        check(each.name in values, f"method.{each.name} is missing: give it a value")
    chosen = frozen(settings, values, "method.")
    check_options(chosen, settings, "method.")
    return method, chosen

"""A method of learning: its settings, and a learner that trains by epochs."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import MISSING, Field, dataclass, field, fields, is_dataclass
from importlib import import_module
from math import inf
from typing import Any, ClassVar

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional
from torch.nn.utils import clip_grad_norm_
from torch.optim import Adam

from labyrinth_core.checks import Checks
from labyrinth_core.evaluation import LabyrinthArrays
from labyrinth_core.learning.networks.acting import BATCH, NetworkPolicy, outputs_of
from labyrinth_core.learning.networks.network import ACTIONS, MOMENTUM, Network, usual_defaults
from labyrinth_core.learning.problem import Observations, Problem, parts_of
from labyrinth_core.learning.spec import NetworkSpec, PolicySpec
from labyrinth_core.pictures import DEFAULT_IMAGE_SIZE

Acting = Callable[[NDArray[Any]], NDArray[np.float32]]
"""A policy as a function from B observations to the scores of the four actions, shape (B, 4)."""

SETTLED_BY = 256
"""The batch size of `settle`, on which the statistics depend."""


def setting(default: Any, meaning: str, *, at_least: float = 0, at_most: float = inf) -> Any:
    """Return the field that declares a setting of a method.

    Args:
        default: The value if the user gives none; MISSING if the user must give one.
        meaning: A phrase in which a noun says what the value is.
        at_least: The minimum of a number.
        at_most: The maximum of a number.
    """
    metadata = {"meaning": meaning, "checks": Checks(at_least, at_most)}
    return field(default=default, metadata=metadata)


@dataclass(frozen=True)
class BaseSettings:
    """The settings of every method; a method declares further ones with `setting`.

    To change only the default of a setting, write `epochs: int = 30`: meaning and limits stay.
    """

    epochs: int = setting(100, "number of calls of `Learner.epoch`", at_least=1)
    evaluate_every: int = setting(
        2, "number of epochs between evaluations on train and validation", at_least=1
    )
    batch_size: int = setting(64, "number of transitions in a gradient step", at_least=2)
    learning_rate: float = setting(
        0.0005, "learning rate of Adam (5e-4 in the supplement, section 3)"
    )

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        for base in cls.__mro__[1:]:
            for each in fields(base) if is_dataclass(base) else ():
                default = vars(cls).get(each.name, MISSING)
                if default is not MISSING and not isinstance(default, Field):
                    setattr(cls, each.name, field(default=default, metadata=each.metadata))


class Learner(ABC):
    """A method during training.

    Checkpoints save its attributes, which may be networks, optimizers, arrays and numbers. Nothing
    else may change between epochs.
    """

    policy: nn.Module
    """The network that is evaluated and kept; the action is its highest output."""
    max_gradient: ClassVar[float] = inf
    """The norm to which the gradients of a step are clipped."""
    renews: ClassVar[bool] = False
    """Whether the method can learn from new labyrinths in each epoch (`train_labyrinths=fresh`)."""
    own_network: ClassVar[bool] = False
    """Whether a user's method has its own network for pictures, in place of `encoder`."""
    protocol: ClassVar[str | None] = None
    """The only protocol that the method supports; None for all protocols but `authors`."""

    def __init__(self, problem: Problem, settings: Any) -> None:
        self.problem = problem
        self.settings = settings
        self.policy = self.make(problem.spec, settings).to(problem.device)
        self.optimizer = self.adam(self.policy)

    @staticmethod
    @contextmanager
    def seeded(seed: int, device: torch.device) -> Iterator[None]:
        """Let the block compute with PyTorch's usual defaults and random numbers of its own.

        Args:
            seed: The seed of weights and dropout; afterwards PyTorch goes on where it was before.
            device: The device to compute on.
        """
        # Older versions of PyTorch cannot fork the random state of Apple's GPUs.
        forked = [device] if device.type in ("cuda", "xpu") else []
        kind = forked[0].type if forked else "cuda"
        with usual_defaults(), torch.random.fork_rng(devices=forked, device_type=kind):
            torch.manual_seed(seed)
            yield

    @classmethod
    def settings_class(cls) -> Any:
        """Return the class of the method's settings.

        It is the class `Settings` of its module or, if that has none, of the module of the method
        it inherits from; else `BaseSettings`.
        """
        declared = (
            getattr(import_module(each.__module__), "Settings", None) for each in cls.__mro__
        )
        return next(filter(None, declared), BaseSettings)

    @classmethod
    def make(cls, spec: NetworkSpec, settings: Any) -> nn.Module:  # noqa: ARG003
        """Return a fresh network for the policy; override this to use another class."""
        return Network(spec)

    @classmethod
    def image_size(cls, spec: NetworkSpec, settings: Any, height: int, width: int) -> int:  # noqa: ARG003
        """Return the pixels on each side of the pictures that the policy sees.

        Args:
            spec: The network, with the size of the labyrinths that it was trained on.
            settings: The settings of the method.
            height: The number of rows of the labyrinths to act in, which may have another size.
            width: The number of their columns.

        Raises:
            PolicyError: The policy cannot see labyrinths of that size.
        """
        return DEFAULT_IMAGE_SIZE

    @classmethod
    def figures(
        cls,
        policy: Acting,  # noqa: ARG003
        train: LabyrinthArrays,  # noqa: ARG003
        validation: LabyrinthArrays,  # noqa: ARG003
    ) -> dict[str, float]:
        """Return the metrics, besides success rates, of a policy evaluated during training."""
        return {}

    @classmethod
    def is_better(cls, figures: Mapping[str, float], best: Mapping[str, float]) -> bool:
        """Return whether the policy with these metrics replaces the best so far.

        By default its SR on validation has to be as high: of equally good policies the latest is
        kept, which has learnt for longer.
        """
        return figures["validation_sr"] >= best["validation_sr"]

    @classmethod
    def player(cls, policy: Acting, spec: NetworkSpec, settings: Any) -> Any:  # noqa: ARG003
        """Return the policy that acts, in any form that `evaluate` accepts.

        By default it is a function, which has no memory and so is evaluated by look-ups. A method
        whose policy has a memory returns an object with `reset(count)` and `act(observations)`,
        which then plays the episodes step by step, during training and in evaluation.

        Args:
            policy: A function from B observations to scores of shape (B, 4).
            spec: The network, with the size of the labyrinths to act in.
            settings: The settings of the method.
        """
        return policy

    @classmethod
    @usual_defaults()
    def trained(
        cls,
        weights: Mapping[str, Tensor],
        spec: NetworkSpec,
        settings: Any,
        device: torch.device | str = "cpu",
    ) -> NetworkPolicy:
        """Return the policy that was trained, as `player` takes it.

        Args:
            weights: The weights by name.
            spec: The network, with the size of the labyrinths that it was trained on.
            settings: The settings of the method.
            device: The device to compute on.

        Raises:
            RuntimeError: The weights are those of another network.
        """
        network = cls.make(spec, settings).to(device)
        network.load_state_dict(weights)
        return NetworkPolicy(network)

    @property
    def acting(self) -> NetworkPolicy:
        """The policy as it is now, as `player` takes it."""
        return NetworkPolicy(self.policy)

    @property
    def policy_spec(self) -> PolicySpec:
        """The specification of the policy, if its network is one of the library's."""
        spec, resize = self.problem.spec, self.problem.arrays.spec.resize
        return PolicySpec.of_method(spec, self.settings, resize)

    def renew(self, problem: Problem) -> None:
        """Take the labyrinths of the next epoch, if each epoch has new ones.

        A method that keeps numbers of states overrides this: they belong to the old labyrinths.
        """
        self.problem = problem

    @abstractmethod
    def epoch(self) -> dict[str, float]:
        """Train for an epoch; return metrics to log, among them `loss`."""

    def network(self, outputs: int = ACTIONS, frames: int = 1) -> Network:
        """Return a fresh network with the run's encoder; see `Network`."""
        return Network(self.problem.spec, outputs, frames).to(self.problem.device)

    def adam(self, network: nn.Module) -> Adam:
        """Return an Adam optimizer for a network."""
        return Adam(network.parameters(), lr=self.settings.learning_rate)

    def descend(self, optimizer: Adam, loss: Tensor) -> None:
        """Take a gradient step."""
        optimizer.zero_grad()
        loss.backward()
        if self.max_gradient < inf:
            clip_grad_norm_(optimizer.param_groups[0]["params"], self.max_gradient)
        optimizer.step()

    def tensor(self, array: NDArray[Any]) -> Tensor:
        """Return an array as a tensor on the device, in float32 if it has no float64."""
        if self.problem.device.type == "mps" and array.dtype == np.float64:
            array = array.astype(np.float32)
        return torch.as_tensor(array, device=self.problem.device)

    def see(self, *states: NDArray[np.int64]) -> Tensor:
        """Return the observations of states; of several arrays, concatenated on the last axis."""
        return torch.cat([self.problem.observations[each] for each in states], -1)

    def outputs(self, network: nn.Module, *states: NDArray[np.int64]) -> Tensor:
        """Return a network's outputs in evaluation mode, shape (N, outputs).

        Args:
            network: The network.
            states: The numbers of N states, shape (N,); several arrays for a network that sees
                several states at once. None for all states.
        """
        states = states or (np.arange(len(self.problem.observations)),)
        outputs, count = torch.empty(0), len(states[0])
        for part in parts_of(count, BATCH):
            some = outputs_of(network, self.see(*(each[part] for each in states)))
            if not len(outputs):
                outputs = some.new_empty((count, *some.shape[1:]))
            # Thousands of small results, if kept, would lie between the large blocks of the batches
            # and keep their memory from being used again: at 25x25 half a megabyte for each batch.
            outputs[part[0] : part[-1] + 1] = some
        return outputs

    def batches(self, count: int) -> list[NDArray[np.int64]]:
        """Return the numbers from 0 to `count` - 1 in random order, split into batches."""
        order = self.problem.rng.permutation(count)
        return np.array_split(order, -(-count // self.settings.batch_size))

    def clone(
        self,
        network: nn.Module,
        optimizer: Adam,
        states: tuple[NDArray[np.int64], ...],
        labels: NDArray[np.int64],
    ) -> float:
        """Train a classifier for one pass over its labels; return the mean cross-entropy.

        Args:
            network: The classifier, which is set to training mode.
            optimizer: The classifier's optimizer.
            states: The numbers of N states, shape (N,); several arrays for a network that sees
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


def settle(network: nn.Module, observations: Observations) -> None:
    """Compute batch normalisation's running statistics, and switch to evaluation mode.

    For methods that train in evaluation mode, where the statistics of a fresh network would keep
    their initial values. The observations are on the network's device.
    """
    normalising = [each for each in network.modules() if isinstance(each, nn.BatchNorm2d)]
    for layer in normalising:
        layer.reset_running_stats()
        layer.momentum = None  # The mean over all batches, weighted equally.
    network.train()
    with torch.no_grad():
        for states in parts_of(len(observations), SETTLED_BY):
            network(observations[states])
    for layer in normalising:
        layer.momentum = MOMENTUM
    network.eval()

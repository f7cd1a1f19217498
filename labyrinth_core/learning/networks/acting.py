"""Build networks from their specification, and wrap them as policies."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from labyrinth_core.errors import printable_line
from labyrinth_core.evaluation import PolicyError, TrainedRun
from labyrinth_core.learning.networks.mapping import Mapper, MapperPolicy
from labyrinth_core.learning.networks.network import Averaged, Network, usual_defaults
from labyrinth_core.learning.networks.planning import Planner
from labyrinth_core.learning.spec import MapperSpec, NetworkSpec, PlannerSpec, PolicySpec
from labyrinth_core.pictures import DEFAULT_IMAGE_SIZE
from labyrinth_core.world import Task

BATCH = 64
"""Observations per forward pass without gradients; with more, layers exceed caches."""


def make_network(
    spec: NetworkSpec, *, average: bool = False, own: PlannerSpec | MapperSpec | None = None
) -> nn.Module:
    """Return a policy's network with fresh weights.

    Args:
        spec: The shape of the network; a planner needs the size of its training labyrinths.
        average: Whether outputs are averaged over the symmetries of the picture when acting.
        own: The settings of a planner or a mapper; None for a network with an encoder.
    """
    network: nn.Module
    if isinstance(own, PlannerSpec):
        network = Planner(DEFAULT_IMAGE_SIZE / max(spec.height, spec.width), own)
    elif isinstance(own, MapperSpec):
        network = Mapper(own)
    else:
        network = Network(spec)
    return Averaged(network) if average else network


def outputs_of(network: nn.Module, observations: Tensor) -> Tensor:
    """Return a network's outputs in evaluation mode: no dropout, running statistics, no gradient.

    All code that acts, labels or judges during training calls this function, with any number of
    observations on the network's device. It restores the network's mode.
    """
    training = network.training
    network.eval()
    try:
        with torch.no_grad():
            return torch.cat([network(batch) for batch in observations.split(BATCH)])
    finally:
        network.train(training)


class NetworkPolicy:
    """A network as a policy."""

    def __init__(self, network: nn.Module) -> None:
        self.network = network

    def __call__(self, observations: NDArray[Any]) -> NDArray[np.float32]:
        """Return the scores of the four actions, shape (B, 4)."""
        device = next(self.network.parameters()).device
        scores = outputs_of(self.network, torch.tensor(observations, device=device))
        array: NDArray[np.float32] = scores.float().cpu().numpy()
        return array


class TrainedPolicy(ABC):
    """A policy with one of the library's networks, ready for `evaluate`."""

    network: Any
    spec: PolicySpec
    """The specification, which says what the policy needs to see."""
    run: TrainedRun | None = None
    """The training run that made it, if it is known."""

    @staticmethod
    def of(spec: PolicySpec, weights: Mapping[str, Tensor]) -> TrainedPolicy:
        """Return a policy on the CPU.

        Args:
            spec: The specification of the policy.
            weights: The weights by name.

        Raises:
            PolicyError: A name, a shape or a dtype is not that of the specified network.
        """

        def make() -> nn.Module:
            return make_network(spec.network, average=spec.average, own=spec.own)

        # On this device no memory is allocated: a specification could ask for any amount.
        with usual_defaults(), torch.device("meta"):
            expected = {name: (one.shape, one.dtype) for name, one in make().state_dict().items()}
        for name in sorted(expected.keys() | weights.keys()):
            tensor = weights.get(name)
            actual = None if tensor is None else (tensor.shape, tensor.dtype)
            if actual != expected.get(name):
                is_, should_be = map(_described, (actual, expected.get(name)))
                raise PolicyError(f"{printable_line(name):.200} is {is_}, not {should_be}")
        with usual_defaults():
            network = make()
        network.load_state_dict(weights)
        network.eval()
        return (
            LoadedMapper(network, spec)
            if isinstance(network, Mapper)
            else LoadedPolicy(network, spec)
        )

    @abstractmethod
    def for_labyrinths(self, height: int, width: int, task: Task) -> TrainedPolicy:
        """Return the policy for labyrinths of another size than in training.

        Raises:
            PolicyError: The labyrinths cannot be shown to the policy.
        """

    @abstractmethod
    def predict(
        self,
        observation: NDArray[Any],
        state: Any = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[Any, Any]:
        """Return actions and the state, as `predict` of Stable-Baselines3 does."""


class LoadedPolicy(NetworkPolicy, TrainedPolicy):
    """The policy of a loaded network: a function from observations to scores."""

    def __init__(self, network: nn.Module, spec: PolicySpec) -> None:
        super().__init__(network)
        self.spec = spec
        self.observation, self.image_size, self.resize = (
            spec.observation,
            spec.image_size_in,
            spec.resize,
        )

    def for_labyrinths(self, height: int, width: int, task: Task) -> LoadedPolicy:
        """Return this policy, after checking that it can be shown such labyrinths.

        Raises:
            PolicyError: The labyrinths cannot be shown to the policy.
        """
        self.spec.require_fit(height, width, task)
        return self

    def __call__(self, observations: NDArray[Any]) -> NDArray[np.float32]:
        """Return the scores of the four actions, shape (B, 4).

        Raises:
            PolicyError: The observations are of another kind than the policy was trained on.
        """
        _require_kind(self.spec, observations)
        return super().__call__(observations)

    def predict(
        self,
        observation: NDArray[Any],
        state: Any = None,
        episode_start: NDArray[np.bool_] | None = None,  # noqa: ARG002
        deterministic: bool = True,  # noqa: ARG002
    ) -> tuple[Any, Any]:
        """Return actions and the state, as `predict` of Stable-Baselines3 does.

        Args:
            observation: B observations, or one without the first axis.
            state: Returned unchanged: the policy has no memory.
            episode_start: Ignored, for the same reason.
            deterministic: Ignored: the action is always the one with the highest score.

        Returns:
            The actions, shape (B,), or one action; and the state.

        Raises:
            PolicyError: The observations are of another kind than the policy was trained on.
        """
        observations, one = _batch_of(self.spec, observation)
        actions = self(observations).argmax(axis=1)
        return actions[0] if one else actions, state


class LoadedMapper(MapperPolicy, TrainedPolicy):
    """The policy of a loaded mapper, for labyrinths of the size it was trained on."""

    def __init__(self, network: Mapper, spec: PolicySpec) -> None:
        super().__init__(network, spec.network.height, spec.network.width)
        self.spec, self.resize = spec, spec.resize

    def act(
        self, observations: NDArray[np.uint8], episodes: NDArray[np.int64] | None = None
    ) -> NDArray[np.int64]:
        """Return the actions, shape (B,); see `MapperPolicy.act`.

        Raises:
            PolicyError: The observations are not pictures.
            ValueError: The pictures have more colours than flat ones have.
        """
        _require_kind(self.spec, observations)
        return super().act(observations, episodes)

    def predict(
        self,
        observation: NDArray[np.uint8],
        state: tuple[MapperPolicy, ...] | None = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,  # noqa: ARG002
    ) -> tuple[Any, tuple[MapperPolicy, ...]]:
        """Return actions and the state, as `predict` of Stable-Baselines3 does.

        Args:
            observation: B pictures, shape (B, 600, 600, 3), or one without the first axis.
            state: The state returned for the preceding pictures; None when episodes begin.
            episode_start: Which episodes begin with these pictures, shape (B,); None if no episode
                does.
            deterministic: Ignored: the action always follows from the plan.

        Returns:
            The actions, shape (B,), or one action; and the memory of each episode.

        Raises:
            PolicyError: The observations are not pictures.
            ValueError: The pictures have more colours than flat ones have.
        """
        pictures, one = _batch_of(self.spec, observation)
        _require_kind(self.spec, pictures)
        begins = np.zeros(len(pictures)) if episode_start is None else episode_start
        state = tuple(
            MapperPolicy(self.network, *self.size) if each is None or begin else each
            for each, begin in zip(state or [None] * len(pictures), begins, strict=True)
        )
        actions = [
            each.act(picture[None])[0] for each, picture in zip(state, pictures, strict=True)
        ]
        return actions[0] if one else np.array(actions), state


def _described(tensor: tuple[torch.Size, torch.dtype] | None) -> str:
    if tensor is None:
        return "absent"
    shape, dtype = tensor
    return f"{str(dtype).removeprefix('torch.')} of shape {tuple(shape)}"


def _batch_of(spec: PolicySpec, observation: NDArray[Any]) -> tuple[NDArray[Any], bool]:
    """Return B observations, and whether a single one was given, without the first axis."""
    one = observation.ndim == (3 if spec.observation == "image" else 1)
    return observation[None] if one else observation, one


def _require_kind(spec: PolicySpec, observations: Any) -> None:
    shown = "text" if isinstance(observations, list) else type(observations).__name__
    if isinstance(observations, np.ndarray):
        shown = "image" if observations.dtype == np.uint8 else "vector"
        if shown == "vector" and observations.ndim > 2:
            shown = f"an array of {observations.dtype}, not uint8"
    if shown != spec.observation:
        raise PolicyError(f"the policy needs observation={spec.observation}, but is shown {shown}")

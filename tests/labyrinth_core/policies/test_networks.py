"""The networks have the shapes of the supplement's Tables 1 and 2."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch
from torch import nn

from labyrinth_core import sample_labyrinth, shortest_route
from labyrinth_core.learning import BaseSettings, Learner, NetworkSpec, Problem
from labyrinth_core.world import Task

pytestmark = pytest.mark.slow

LABYRINTH = sample_labyrinth(3, 4, Task.NAVIGATION, np.random.default_rng(0))
ROUTE = np.array(shortest_route(LABYRINTH, np.random.default_rng(0)))


class Idle(Learner):
    """Learns nothing."""

    def epoch(self) -> dict[str, float]:
        return {"loss": 0.5}


def network(encoder: str, task: str = "navigation", **options: int) -> Any:
    """Return a fresh network as a method makes it."""
    spec = NetworkSpec(encoder, 3, 4, task)
    problem = Problem.of_labyrinths([LABYRINTH], [ROUTE], 64, spec)
    return Idle(problem, BaseSettings()).network(**options)


def parameters(module: nn.Module) -> int:
    return sum(weight.numel() for weight in module.parameters())


def pictures(count: int) -> torch.Tensor:
    return torch.randint(0, 256, (count, 64, 64, 3), dtype=torch.uint8)


def inputs_of(module: nn.Module, observations: torch.Tensor) -> list[torch.Tensor]:
    """Return what the encoder of a network is given for observations, and what it returns."""
    seen: list[torch.Tensor] = []
    handle = module.encoder.register_forward_hook(  # type: ignore[union-attr]
        lambda _, given, result: seen.extend([given[0], result])
    )
    module(observations)
    handle.remove()
    return seen


def test_the_policies_have_the_parameters_of_table_1() -> None:
    assert parameters(network("cnn")) == 865_700
    resnet = network("resnet18")
    assert parameters(resnet.encoder) == 11_176_512
    assert parameters(resnet) == 11_176_512 + 2 * (512 * 512 + 512) + 4 * 513


def test_table_1a_layer_by_layer() -> None:
    layers = [type(each).__name__ for each in network("cnn").modules() if not [*each.children()]]
    normalised = ["Conv2d", "BatchNorm2d", "LeakyReLU"]
    dense = ["Linear", "LeakyReLU", "Dropout"]
    first = ["Conv2d", "LeakyReLU"]
    assert layers == [*first, *normalised * 2, "Flatten", *dense * 2, "Linear"]


def test_the_first_pooling_of_resnet_keeps_the_size_as_in_table_1b() -> None:
    resnet = network("resnet18")
    given, features = inputs_of(resnet, pictures(2))
    assert nn.Sequential(*list(resnet.encoder)[:4])(given).shape == (2, 64, 32, 32)
    assert features.shape == (2, 512)


@pytest.mark.parametrize("frames", [1, 2])
@pytest.mark.parametrize("encoder", ["cnn", "resnet18"])
def test_pictures_give_four_scores(encoder: str, frames: int) -> None:
    seen = torch.cat([pictures(2)] * frames, -1)
    assert network(encoder, frames=frames)(seen).shape == (2, 4)
    assert network(encoder, outputs=1, frames=frames)(seen).shape == (2, 1)


@pytest.mark.parametrize("frames", [1, 2])
@pytest.mark.parametrize("task", list(Task))
def test_vectors_give_four_scores(task: Task, frames: int) -> None:
    tiles, grid = task.rules.positions, 5 * 7
    vectors = torch.zeros((2, tiles + grid), dtype=torch.int32)
    vectors[:, :tiles] = torch.tensor([-1, grid - 1] * 3)[:tiles]
    seen = torch.cat([vectors] * frames, -1)
    assert network("mlp", str(task), frames=frames)(seen).shape == (2, 4)


def test_a_position_in_a_vector_is_a_place_and_not_an_amount() -> None:
    assert network("mlp").encoder.layer.in_features == 3 * (35 + 1) + 35


def test_pictures_are_scaled_to_the_unit_interval() -> None:
    seen = pictures(2)
    inputs = inputs_of(network("cnn"), seen)[0]
    assert inputs.shape == (2, 3, 64, 64)
    assert torch.equal((inputs.permute(0, 2, 3, 1) * 255).round().byte(), seen)

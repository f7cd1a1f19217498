"""The networks have the shapes of the supplement's Tables 1 and 2."""

from __future__ import annotations

import pytest
import torch
from torch import nn

from labyrinth_core.learning import NetworkSpec
from labyrinth_core.learning.networks.network import Mlp, Network, ResNet18, as_input
from labyrinth_core.world import Task

pytestmark = pytest.mark.slow


def spec(encoder: str, task: str = "navigation") -> NetworkSpec:
    return NetworkSpec(encoder, 3, 4, task)


def parameters(network: nn.Module) -> int:
    return sum(weight.numel() for weight in network.parameters())


def pictures(count: int) -> torch.Tensor:
    return torch.randint(0, 256, (count, 64, 64, 3), dtype=torch.uint8)


def test_the_policies_have_the_parameters_of_table_1() -> None:
    assert parameters(Network(spec("cnn"))) == 865_700
    assert parameters(ResNet18()) == 11_176_512
    assert parameters(Network(spec("resnet18"))) == 11_176_512 + 2 * (512 * 512 + 512) + 4 * 513


def test_table_1a_layer_by_layer() -> None:
    layers = [
        type(layer).__name__ for layer in Network(spec("cnn")).modules() if not [*layer.children()]
    ]
    normalised = ["Conv2d", "BatchNorm2d", "LeakyReLU"]
    dense = ["Linear", "LeakyReLU", "Dropout"]
    first = ["Conv2d", "LeakyReLU"]
    assert layers == [*first, *normalised * 2, "Flatten", *dense * 2, "Linear"]


def test_the_first_pooling_of_resnet_keeps_the_size_as_in_table_1b() -> None:
    encoder = ResNet18()
    features = as_input(pictures(1))
    assert nn.Sequential(*list(encoder)[:4])(features).shape == (1, 64, 32, 32)
    assert encoder(features).shape == (1, 512)


@pytest.mark.parametrize("frames", [1, 2])
@pytest.mark.parametrize("encoder", ["cnn", "resnet18"])
def test_pictures_give_four_scores(encoder: str, frames: int) -> None:
    seen = torch.cat([pictures(2)] * frames, -1)
    assert Network(spec(encoder), frames=frames)(seen).shape == (2, 4)
    assert Network(spec(encoder), outputs=1, frames=frames)(seen).shape == (2, 1)


@pytest.mark.parametrize("frames", [1, 2])
@pytest.mark.parametrize("task", list(Task))
def test_vectors_give_four_scores(task: Task, frames: int) -> None:
    tiles, grid = task.rules.positions, 5 * 7
    vectors = torch.zeros((2, tiles + grid), dtype=torch.int32)
    vectors[:, :tiles] = torch.tensor([-1, grid - 1] * 3)[:tiles]
    seen = torch.cat([vectors] * frames, -1)
    assert Network(spec("mlp", task=str(task)), frames=frames)(seen).shape == (2, 4)


def test_a_position_in_a_vector_is_a_place_and_not_an_amount() -> None:
    encoder = Mlp(spec("mlp"))
    assert encoder.layer.in_features == 3 * (35 + 1) + 35


def test_pictures_are_scaled_to_the_unit_interval() -> None:
    seen = pictures(2)
    inputs = as_input(seen)
    assert inputs.shape == (2, 3, 64, 64)
    assert torch.equal((inputs.permute(0, 2, 3, 1) * 255).round().byte(), seen)

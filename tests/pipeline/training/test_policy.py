"""The file of a policy, and the evaluation mode in which it acts."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import save_file

from labyrinth_core.data.errors import DatasetError
from labyrinth_core.policies.networks.acting import BATCH, NetworkPolicy, outputs_of
from labyrinth_core.policies.networks.network import Network
from labyrinth_core.policies.spec import NetworkSpec
from pipeline.training.policy import read_policy, save_policy

pytestmark = pytest.mark.slow

SPEC = NetworkSpec("cnn", 1, 3, 3, "navigation")


@pytest.fixture(scope="module")
def pictures() -> np.ndarray:
    return np.random.default_rng(0).integers(0, 256, (BATCH + 3, 64, 64, 3), np.uint8)


def test_acting_in_training_mode_neither_drops_out_nor_moves_the_statistics(
    pictures: np.ndarray,
) -> None:
    network = Network(SPEC).train()
    before = {name: tensor.clone() for name, tensor in network.state_dict().items()}
    first, second = (NetworkPolicy(network)(pictures) for _ in range(2))
    assert np.array_equal(first, second)
    assert network.training
    after = network.state_dict()
    assert all(torch.equal(tensor, after[name]) for name, tensor in before.items())
    assert not outputs_of(network, torch.tensor(pictures[:2])).requires_grad


def test_a_policy_sees_each_observation_by_itself(pictures: np.ndarray) -> None:
    policy = NetworkPolicy(Network(SPEC))
    together = policy(pictures)
    assert together.shape == (BATCH + 3, 4)
    assert together.dtype == np.float32
    alone = np.concatenate([policy(pictures[i : i + 1]) for i in (0, 1, BATCH + 2)])
    assert np.allclose(together[[0, 1, BATCH + 2]], alone, atol=1e-5)


def test_a_policy_survives_the_way_to_the_file_and_back(
    tmp_path: Path, pictures: np.ndarray
) -> None:
    network = Network(SPEC)
    save_policy(tmp_path / "policy", network.state_dict(), SPEC)
    loaded = read_policy(tmp_path / "policy", SPEC)
    assert np.array_equal(loaded(pictures[:4]), NetworkPolicy(network)(pictures[:4]))
    assert [path.name for path in tmp_path.iterdir()] == ["policy"]


@pytest.mark.parametrize(
    ("spec", "told"),
    [
        (NetworkSpec("resnet18", 1, 3, 3, "navigation"), "encoder=cnn, not resnet18"),
        (NetworkSpec("cnn", 1, 5, 5, "navigation"), "height=3, not 5; width=3, not 5"),
        (NetworkSpec("cnn", 1, 3, 3, "icy_floor"), "task=navigation, not icy_floor"),
    ],
)
def test_the_policy_of_another_network_is_refused_in_one_line(
    tmp_path: Path, spec: NetworkSpec, told: str
) -> None:
    save_policy(tmp_path / "policy", Network(SPEC).state_dict(), SPEC)
    with pytest.raises(DatasetError, match="is a policy with") as caught:
        read_policy(tmp_path / "policy", spec)
    assert told in str(caught.value)
    assert "\n" not in str(caught.value)


def test_what_is_no_policy_is_refused_in_one_line(tmp_path: Path) -> None:
    (tmp_path / "text").write_text("hello")
    save_file({"a": torch.zeros(1)}, tmp_path / "tensors")
    save_policy(tmp_path / "weights", {"a": torch.zeros(1)}, SPEC)
    for name in ("text", "tensors", "weights", "missing"):
        with pytest.raises(DatasetError) as caught:
            read_policy(tmp_path / name, SPEC)
        assert name in str(caught.value)
        assert "\n" not in str(caught.value)

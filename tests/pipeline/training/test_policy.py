"""The file of a policy, and the evaluation mode in which it acts."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import save_file

from labyrinth_core.errors import DatasetError
from labyrinth_core.learning import NetworkSpec, outputs_of
from labyrinth_core.learning.methods import bc
from labyrinth_core.learning.networks.acting import BATCH, NetworkPolicy
from labyrinth_core.learning.networks.network import Network
from pipeline.training.loop import read_policy, save_policy

pytestmark = pytest.mark.slow

SPEC = NetworkSpec("cnn", 3, 3, "navigation")


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


def test_the_policy_of_another_network_is_refused_in_one_line(tmp_path: Path) -> None:
    path = tmp_path / "policy"
    save_policy(path, Network(SPEC).state_dict(), SPEC)
    with pytest.raises(DatasetError) as caught:
        read_policy(path, bc.Method, bc.Settings(), NetworkSpec("resnet18", 5, 3, "icy_floor"))
    assert str(caught.value) == (
        f"{path} is a policy with encoder=cnn, not resnet18; height=3, not 5; "
        "task=navigation, not icy_floor"
    )


@pytest.mark.parametrize("content", [b"", b"\x80\x04\x95pickle", "tensors", "weights", None])
def test_what_is_no_policy_is_refused_in_one_line(
    tmp_path: Path, content: bytes | str | None
) -> None:
    path = tmp_path / "policy"
    if isinstance(content, bytes):
        path.write_bytes(content)
    elif content == "tensors":
        save_file({"a": torch.zeros(1)}, path)
    elif content == "weights":
        save_policy(path, {"a": torch.zeros(1)}, SPEC)
    with pytest.raises(DatasetError, match=rf"\A{path} [^\n]*\Z"):
        read_policy(path, bc.Method, bc.Settings(), SPEC)

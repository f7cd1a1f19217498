"""The evaluation mode in which a policy acts, whatever the mode of its network."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch

from labyrinth_core.learning import Learner, NetworkSpec, outputs_of

pytestmark = pytest.mark.slow

SPEC = NetworkSpec("cnn", 3, 3, "navigation")
COUNT = 67
"""More than are shown to the network at once, which are 64."""


@pytest.fixture(scope="module")
def pictures() -> np.ndarray:
    return np.random.default_rng(0).integers(0, 256, (COUNT, 64, 64, 3), np.uint8)


@pytest.fixture
def policy() -> Any:
    """A fresh policy, whose network is in the mode for training."""
    policy = Learner.trained(Learner.make(SPEC, None).state_dict(), SPEC, None)
    policy.network.train()
    return policy


def test_acting_in_training_mode_neither_drops_out_nor_moves_the_statistics(
    pictures: np.ndarray, policy: Any
) -> None:
    network = policy.network
    before = {name: tensor.clone() for name, tensor in network.state_dict().items()}
    first, second = (policy(pictures) for _ in range(2))
    assert np.array_equal(first, second)
    assert network.training
    after = network.state_dict()
    assert all(torch.equal(tensor, after[name]) for name, tensor in before.items())
    assert not outputs_of(network, torch.tensor(pictures[:2])).requires_grad


def test_a_policy_sees_each_observation_by_itself(pictures: np.ndarray, policy: Any) -> None:
    together = policy(pictures)
    assert together.shape == (COUNT, 4)
    assert together.dtype == np.float32
    alone = np.concatenate([policy(pictures[i : i + 1]) for i in (0, 1, COUNT - 1)])
    assert np.allclose(together[[0, 1, COUNT - 1]], alone, atol=1e-5)

"""Archives of Stable-Baselines3 with four actions: they act here as their networks do."""

from __future__ import annotations

import io
import json
import zipfile
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import nn

from labyrinth_core import LabyrinthEnv, PolicyError, evaluate, load_arrays
from labyrinth_core.data.errors import DatasetError
from labyrinth_core.evaluation.following import greedy_actions
from pipeline.studies.environments.stable_baselines import read_discrete

pytestmark = pytest.mark.slow


class NatureCnn(nn.Module):
    """The features of a CnnPolicy, under the names that Stable-Baselines3 2.9 gives its layers."""

    def __init__(self, size: int) -> None:
        super().__init__()
        self.cnn = nn.Sequential(
            *(nn.Conv2d(3, 32, 8, 4), nn.ReLU(), nn.Conv2d(32, 64, 4, 2), nn.ReLU()),
            *(nn.Conv2d(64, 64, 3, 1), nn.ReLU(), nn.Flatten()),
        )
        width = self.cnn(torch.zeros(1, 3, size, size)).shape[1]
        self.linear = nn.Sequential(nn.Linear(width, 16), nn.ReLU())

    def forward(self, observations: torch.Tensor) -> torch.Tensor:
        found: torch.Tensor = self.linear(self.cnn(observations))
        return found


def named(prefix: str, module: nn.Module) -> dict[str, torch.Tensor]:
    """Return the weights of a module, not copied, under the name of what it is in the archive."""
    return {f"{prefix}.{key}": value for key, value in module.state_dict().items()}


def cnn_ppo(scaled: bool = True) -> tuple[nn.Module, dict[str, torch.Tensor]]:
    features, action = NatureCnn(40), nn.Linear(16, 4)
    weights = named("action_net", action)
    for prefix in ("features_extractor", "pi_features_extractor", "vf_features_extractor"):
        weights |= named(prefix, features)
    return Seen(nn.Sequential(features, action), scaled), weights


def mlp_ppo() -> tuple[nn.Module, dict[str, torch.Tensor]]:
    parts = [nn.Linear(38, 16), nn.Tanh(), nn.Linear(16, 16), nn.Tanh()]
    action = nn.Linear(16, 4)
    weights = named("mlp_extractor.policy_net", nn.Sequential(*parts))
    weights |= named("value_net", nn.Linear(16, 1)) | named("action_net", action)
    return Seen(nn.Sequential(*parts, action), scaled=False), weights


def flat_dqn() -> tuple[nn.Module, dict[str, torch.Tensor]]:
    parts = [nn.Linear(40 * 40 * 3, 16), nn.ReLU(), nn.Linear(16, 4)]
    weights = named("q_net.q_net", nn.Sequential(*parts))
    return Seen(nn.Sequential(nn.Flatten(), *parts), scaled=True), weights


class Seen(nn.Module):
    """A network, shown observations as Stable-Baselines3 shows them."""

    def __init__(self, network: nn.Module, scaled: bool) -> None:
        super().__init__()
        self.network, self.scaled = network, scaled

    def forward(self, observations: torch.Tensor) -> torch.Tensor:
        values = observations.float()
        if values.ndim == 4:
            values = values.permute(0, 3, 1, 2) / (255 if self.scaled else 1)
        found: torch.Tensor = self.network(values)
        return found


def archive(path: Path, weights: dict[str, torch.Tensor], **kwargs: object) -> str:
    stored = io.BytesIO()
    torch.save({name: tensor.detach() for name, tensor in weights.items()}, stored)
    with zipfile.ZipFile(path, "w") as file:
        file.writestr("data", json.dumps({"policy_kwargs": kwargs}))
        file.writestr("policy.pth", stored.getvalue())
    return str(path)


POLICIES = {
    "CnnPolicy of PPO": (cnn_ppo, {}, {"image_size": 40}),
    "the same, not scaled": (
        lambda: cnn_ppo(scaled=False),
        {"normalize_images": False},
        {"image_size": 40},
    ),
    "MlpPolicy of PPO": (mlp_ppo, {}, {"observation": "vector"}),
    "MlpPolicy of DQN on pictures": (flat_dqn, {}, {"image_size": 40}),
}


@pytest.mark.parametrize("name", POLICIES)
def test_an_archive_scores_what_its_network_does_stepped_in_the_environment(
    datasets, tmp_path, name
):
    torch.manual_seed(1)
    make, kwargs, shown = POLICIES[name]
    network, weights = make()
    arrays = load_arrays(datasets, "3x4", "train", **shown)
    with torch.no_grad():
        scores = network(torch.tensor(arrays.observations))
        # No action is the best in all states; the weights of the archive are the network's own.
        *_, bias = network.parameters()
        bias -= scores.mean(dim=0)
        best = (scores - scores.mean(dim=0)).argmax(dim=1).numpy()
    policy = read_discrete(archive(tmp_path / "a.zip", weights, **kwargs))
    acting = ~arrays.terminal
    assert len(set(best[acting])) > 1
    assert (greedy_actions(policy, arrays)[acting] == best[acting]).all()
    episodes = evaluate(policy, datasets, "3x4", splits=["train"], **shown).splits["train"].episodes
    for place, labyrinth in enumerate(arrays.labyrinths):
        env, rewards, over = LabyrinthEnv(labyrinth=labyrinth, **shown), [], False
        observation, _ = env.reset(seed=0)
        while not over:
            with torch.no_grad():
                action = int(network(torch.tensor(observation[None])).argmax())
            observation, reward, terminated, truncated, _ = env.step(action)
            rewards.append(reward)
            over = terminated or truncated
        assert episodes.moves[place] == len(rewards)
        assert episodes.returns[place] == pytest.approx(sum(rewards), abs=1e-9)


def changed(weights: dict[str, torch.Tensor], kind: str) -> dict[str, torch.Tensor]:
    if kind == "continuous":
        return weights | {"log_std": torch.zeros(4)}
    if kind == "three actions":
        return weights | named("action_net", nn.Linear(16, 3))
    return weights | {"features_extractor.own.weight": torch.zeros(3)}


@pytest.mark.parametrize(
    ("kind", "message"),
    [
        ("continuous", "does not choose among four actions"),
        ("three actions", "does not choose among four actions"),
        ("own features", "its features extractor is not NatureCNN"),
    ],
)
def test_an_archive_of_something_else_is_refused(tmp_path, kind, message):
    with pytest.raises(DatasetError, match=message):
        read_discrete(archive(tmp_path / "a.zip", changed(mlp_ppo()[1], kind)))


@pytest.mark.parametrize(
    ("make", "shown"),
    [
        (mlp_ppo, {"image_size": 40}),
        (cnn_ppo, {"observation": "vector"}),
        (cnn_ppo, {"image_size": 64}),
        (flat_dqn, {"image_size": 8}),
    ],
)
def test_other_observations_than_it_was_trained_on_are_told_in_one_line(
    datasets, tmp_path, make, shown
):
    policy = read_discrete(archive(tmp_path / "a.zip", make()[1]))
    with pytest.raises(PolicyError, match=r"a\.zip was trained on other observations than") as told:
        evaluate(policy, datasets, "3x4", **shown)
    assert "\n" not in str(told.value)
    with pytest.raises(PolicyError, match=r"a\.zip looks at pictures or vectors"):
        policy(["a text"])


def test_nothing_but_numpy_arrays_comes_back(tmp_path):
    scores = read_discrete(archive(tmp_path / "a.zip", mlp_ppo()[1]))(np.zeros((5, 38), np.int32))
    assert isinstance(scores, np.ndarray)
    assert scores.shape == (5, 4)

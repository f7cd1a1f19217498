"""Experts reach the returns that they are kept for; archives of others are read, and only read."""

from __future__ import annotations

import io
import json
import pickle
import zipfile
from importlib.util import find_spec
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import nn

from labyrinth_core.data.errors import DatasetError
from pipeline.config.analysis import LABYRINTH
from pipeline.config.run import RunConfig, resolve
from pipeline.studies.environments.environment import environment_of
from pipeline.studies.environments.experts import expert_of, source_of
from pipeline.studies.environments.stable_baselines import read_archive

pytestmark = pytest.mark.slow

NEEDS_MUJOCO = pytest.mark.skipif(
    find_spec("mujoco") is None, reason="MuJoCo is not there: pip install -e '.[analysis]'"
)
DATASET = resolve(RunConfig(stages=["build"], data_dir="unused")).dataset


@pytest.mark.parametrize(
    ("name", "seeds", "least", "worst"),
    [
        ("CartPole-v1", 5, 500, 500),
        ("MountainCar-v0", 60, -110, -125),
        *(
            pytest.param(name, 8, least, -np.inf, marks=NEEDS_MUJOCO)
            for name, least in (
                ("Hopper-v5", 2500),
                ("Walker2d-v5", 2500),
                ("HalfCheetah-v5", 3000),
            )
        ),
    ],
)
def test_experts_are_worth_keeping_and_play_the_same_episode_again(name, seeds, least, worst):
    played = [environment_of(name, DATASET).play(seed) for seed in (1, *range(seeds))]
    returns = [each.total for each in played[1:]]
    assert np.mean(returns) >= least
    assert min(returns) >= worst
    first, again = played[0], played[2]
    assert first.total == again.total
    assert np.array_equal(first.states, again.states)
    if first.actions.ndim == 2:
        assert np.abs(first.actions).max() <= 1
        provenance = json.loads(source_of(name).read_text())
        assert provenance["environment"] == name
        assert provenance["return"]["mean"] >= least


def test_a_seed_gives_the_labyrinth_and_an_optimal_route_of_the_environment():
    import gymnasium

    env = gymnasium.make("labyrinth_core.env:Labyrinth-v0", observation="vector")
    played = environment_of(LABYRINTH, DATASET).play(3)
    observation, info = env.reset(seed=3)
    assert info["distance"] == len(played.actions)
    assert np.array_equal(played.states[0], observation)
    total = 0.0
    for action, state in zip(played.actions, played.states[1:], strict=True):
        observation, reward, terminated, _, _ = env.step(action)
        total += reward
        assert np.array_equal(observation, state)
    assert terminated
    assert total == pytest.approx(played.total)


# Stable-Baselines3 archives, made by hand in the layout of its version 2.9.


def archive_of(path: Path, weights: dict[str, torch.Tensor], activation: str = "") -> str:
    stored = io.BytesIO()
    torch.save(weights, stored)
    kwargs = {"activation_fn": f"<class 'torch.nn.modules.activation.{activation}'>"}
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("data", json.dumps({"policy_kwargs": kwargs if activation else {}}))
        archive.writestr("policy.pth", stored.getvalue())
    return str(path)


def network(names: list[str], sizes: list[int], activation: nn.Module) -> tuple[dict, nn.Module]:
    """Return the weights of a network under the names of its layers, and the network."""
    torch.manual_seed(0)
    layers = [nn.Linear(a, b) for a, b in pairwise(sizes)]
    weights = {
        f"{name}.{kind}": getattr(layer, kind).detach()
        for name, layer in zip(names, layers, strict=True)
        for kind in ("weight", "bias")
    }
    parts = [part for layer in layers for part in (layer, activation)][:-1]
    return weights, nn.Sequential(*parts)


ON_POLICY = ["mlp_extractor.policy_net.0", "mlp_extractor.policy_net.2", "action_net"]
LAYOUTS = {
    "PPO": (ON_POLICY, "", nn.Tanh(), lambda x: x),
    "A2C with ReLU": (ON_POLICY, "ReLU", nn.ReLU(), lambda x: x),
    "SAC": (["actor.latent_pi.0", "actor.latent_pi.2", "actor.mu"], "", nn.ReLU(), torch.tanh),
    "TD3": (["actor.mu.0", "actor.mu.2", "actor.mu.4"], "ELU", nn.ELU(), torch.tanh),
}


@pytest.mark.parametrize("algorithm", LAYOUTS)
def test_the_policy_of_an_archive_acts_as_its_network_does(tmp_path, algorithm):
    names, named, activation, output = LAYOUTS[algorithm]
    weights, net = network(names, [11, 6, 5, 3], activation)
    others = {"log_std": torch.zeros(3), "critic.qf0.0.weight": torch.ones(2, 2)}
    policy = read_archive(archive_of(tmp_path / "a.zip", weights | others, named))
    for observation in np.random.default_rng(0).normal(size=(5, 11)):
        with torch.no_grad():
            expected = output(net(torch.tensor(observation, dtype=torch.float32)))
        assert policy(observation) == pytest.approx(expected.numpy(), abs=1e-5)


@pytest.mark.parametrize(
    "names", [ON_POLICY, ["q_net.q_net.0", "q_net.q_net.2", "q_net.q_net.10"]], ids=["PPO", "DQN"]
)
def test_of_discrete_actions_the_best_is_taken(tmp_path, names):
    weights, net = network(names, [4, 6, 5, 2], nn.ReLU())
    policy = read_archive(archive_of(tmp_path / "a.zip", weights, "ReLU"))
    for observation in np.random.default_rng(0).normal(size=(20, 4)):
        with torch.no_grad():
            values = net(torch.tensor(observation, dtype=torch.float32))
        assert policy(observation) == int(values.argmax())


def test_an_archive_plays_in_place_of_our_expert(tmp_path):
    weights, _ = network(ON_POLICY, [4, 6, 5, 2], nn.Tanh())
    path = archive_of(tmp_path / "a.zip", weights)
    assert 8 <= environment_of("CartPole-v1", DATASET, path).play(0).total < 500


@pytest.mark.parametrize("name", ["MountainCar-v0", pytest.param("Hopper-v5", marks=NEEDS_MUJOCO)])
def test_an_archive_is_refused_where_it_does_not_fit(tmp_path, name):
    weights, _ = network(ON_POLICY, [4, 6, 5, 2], nn.Tanh())
    path = archive_of(tmp_path / "a.zip", weights)
    with pytest.raises(DatasetError, match=f"a.zip is no expert for {name}"):
        environment_of(name, DATASET, path)


class Trap:
    """What a pickle could run, were it unpickled."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self):
        return Path.touch, (self.path,)


def broken(folder: Path, kind: str) -> str:
    path = folder / "bad.zip"
    weights, _ = network(ON_POLICY, [4, 6, 5, 2], nn.Tanh())
    if kind == "missing":
        return str(path)
    if kind == "no zip":
        path.write_text("Hello")
    elif kind == "other policy":
        return archive_of(path, {"features_extractor.cnn.0.weight": torch.ones(1)})
    elif kind == "activation":
        return archive_of(path, weights, "Softmax")
    elif kind == "damaged":
        with zipfile.ZipFile(path, "w", zipfile.ZIP_LZMA) as archive:
            archive.writestr("policy.pth", bytes(range(200)))
        with path.open("r+b") as file:
            file.seek(60)
            file.write(bytes(99))
    else:
        archive_of(path, weights)
        content = {"a pickle": pickle.dumps(Trap(folder / "sprung")), "cut": b"PK"}[kind]
        with zipfile.ZipFile(path, "w") as archive:
            archive.writestr("data", "{}")
            archive.writestr("policy.pth", content)
    return str(path)


@pytest.mark.parametrize(
    "kind", ["missing", "no zip", "other policy", "activation", "damaged", "a pickle", "cut"]
)
def test_a_bad_archive_is_refused_in_one_line_and_nothing_in_it_runs(tmp_path, kind):
    with pytest.raises(DatasetError) as caught:
        expert_of("CartPole-v1", broken(tmp_path, kind))
    assert "bad.zip" in str(caught.value)
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "sprung").exists()


def test_weights_that_unpack_to_more_than_the_file_holds_are_refused(tmp_path):
    weights, _ = network(ON_POLICY, [4, 6, 5, 2], nn.Tanh())
    path = archive_of(tmp_path / "large.zip", weights)
    with pytest.raises(DatasetError, match="it has more than 100 bytes"):
        read_archive(path, max_bytes=100)
    weights["action_net.weight"] = torch.zeros(1).as_strided((30_000, 30_000), (0, 0))
    path = archive_of(tmp_path / "strided.zip", weights)
    with pytest.raises(DatasetError, match="weight has more numbers than the file holds"):
        read_archive(path)
    stored, packed = io.BytesIO(), io.BytesIO()
    torch.save({"action_net.weight": torch.zeros(1000, 1000)}, stored)
    with zipfile.ZipFile(stored) as old, zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as new:
        for name in old.namelist():
            new.writestr(name, old.read(name))
    with zipfile.ZipFile(tmp_path / "twice.zip", "w") as archive:
        archive.writestr("policy.pth", packed.getvalue())
        archive.writestr("data", "{}")
    with pytest.raises(DatasetError, match="takes more than 1,000,000 bytes"):
        read_archive(str(tmp_path / "twice.zip"), max_bytes=10**6)


@pytest.mark.parametrize("source", ["nowhere", "some/where/else", "user/missing.zip"])
def test_what_is_neither_a_file_nor_an_id_is_refused(source):
    with pytest.raises(DatasetError, match=r"neither an archive .* nor an id on the Hub"):
        source_of("Hopper-v5", source)

"""Policies for tests: tables of actions, with memory and without."""

from __future__ import annotations

import json
import shutil
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np

from labyrinth_core.learning import NetworkSpec, PolicySpec
from labyrinth_core.learning.spec import PlannerSpec
from labyrinth_core.policies import RunRecord
from labyrinth_core.storage import File
from pipeline.config import TrainingOptions

RELEASED = Path(__file__).parents[2] / "docs" / "results" / "released" / "5x5" / "planner-seed0"
RELEASED_SPEC = PolicySpec(
    NetworkSpec("planner", 5, 5, "navigation"),
    average=True,
    own=PlannerSpec(True, True, True, channels=32, iterations=20, sharpness=3.0),
)


def network_of(spec):
    """Return the network of a policy with fresh weights."""
    from labyrinth_core.learning.networks.acting import make_network

    return make_network(spec.network, average=spec.average, own=spec.own)


def lay_out_run(folder, spec, deviation=1.0, **run):
    """Write a run whose policy has random weights into a new folder; return the folder."""
    import torch
    from safetensors.torch import save_file

    folder.mkdir(parents=True)
    network = network_of(spec)
    for weights in network.parameters():
        torch.nn.init.normal_(weights, std=deviation, generator=torch.Generator().manual_seed(0))
    described = {"network": json.dumps(asdict(spec.network))}
    save_file(network.state_dict(), folder / PolicySpec.WEIGHTS, described)
    settings = {"average": spec.average} | ({} if spec.own is None else asdict(spec.own))
    method = "bc" if spec.own is None else spec.network.encoder
    content = {
        "format": 2,
        "run": {
            "method": method,
            "encoder": spec.network.encoder,
            "observation": spec.observation,
            "protocol": "default",
            "train_labyrinths": None,
            "seed": 0,
            "settings": settings,
            "config": f"{spec.network.height}x{spec.network.width}",
            "dataset": "data/labyrinth",
            "revision": None,
            "fingerprint": "0" * 64,
            **run,
        },
        "computed": {"device": "cpu"},
        "seconds": 1.5,
        "epochs": 1,
        "selected": {"epoch": 1},
        "history": [{"epoch": 1}],
        "files": {PolicySpec.WEIGHTS: File(folder / PolicySpec.WEIGHTS).sha256()},
    }
    spec = replace(spec, resize=TrainingOptions(protocol=content["run"]["protocol"]).resize)
    (folder / PolicySpec.FILE).write_text(json.dumps(spec.to_json()), encoding="utf-8")
    (folder / RunRecord.FILE).write_text(json.dumps(content), encoding="utf-8")
    return folder


class Table:
    """A policy that is a table from observations to actions: what is not in it goes up."""

    def __init__(self, arrays, actions):
        pairs = zip(arrays.observations, actions.tolist(), strict=True)
        self.actions = {key(observation): action for observation, action in pairs}

    def __call__(self, observations):
        return np.array([self.actions.get(key(each), 0) for each in observations])


def key(observation):
    return observation if isinstance(observation, str) else observation.tobytes()


class Remembering:
    """A policy without memory in the form of one with it."""

    def __init__(self, policy):
        self.act = policy
        self.counts = []

    def reset(self, count):
        self.counts.append(count)


class Rounds:
    """A policy with memory: its n-th action in an episode, whatever it sees, is n // `turns`."""

    def __init__(self, turns):
        self.turns = turns

    def reset(self, count):
        self.steps = np.zeros(count, np.int64)

    def act(self, observations):
        assert len(observations) == len(self.steps)
        self.steps += 1
        return (self.steps - 1) // self.turns % 4


def chance(observations, rng):
    """Act at random."""
    return rng.integers(4, size=len(observations))


class Chance:
    """The same, in the form of a policy with memory."""

    def reset(self, count, rng):
        assert count > 0
        self.rng = rng

    def act(self, observations):
        return chance(observations, self.rng)


def mistaken(arrays, share, seed=0):
    """Return optimal actions, but for a share of random ones."""
    rng = np.random.default_rng(seed)
    wrong = rng.random(len(arrays.terminal)) < share
    return np.where(wrong, rng.integers(4, size=len(wrong)), arrays.optimal.argmax(axis=1))


def lay_out_released(folder):
    """Write the planner that was released into a folder, as the Hub would hold it; return it."""
    folder.mkdir(parents=True)
    shutil.copyfile(RELEASED / "model.safetensors", folder / PolicySpec.WEIGHTS)
    (folder / PolicySpec.FILE).write_text(json.dumps(RELEASED_SPEC.to_json()), encoding="utf-8")
    return folder

"""TorchRL: its replay buffer of Minari's episodes, and a few steps on batches that it samples.

`MinariExperienceReplay` of TorchRL 0.12 to 0.14.1 reads every Minari dataset as zeros: it makes the
file of the buffer anew, by `memmap_like`, after it has filled it. So the episodes are given here.
"""

from __future__ import annotations

import tempfile

import minari
import numpy as np
import torch
from comparing import IDS, Episode, compare, fitted, report
from tensordict import TensorDict
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer
from torchrl.data.datasets.minari_data import MinariExperienceReplay


def transitions(episode: minari.EpisodeData) -> TensorDict:
    """Return the transitions of an episode, as TorchRL names them."""
    steps = len(episode)
    following = {
        "observation": episode.observations[1:],
        "reward": episode.rewards[:, None],
        "terminated": episode.terminations[:, None],
        "done": (episode.terminations | episode.truncations)[:, None],
    }
    return TensorDict(
        {
            "observation": episode.observations[:-1],
            "action": episode.actions,
            "next": TensorDict(following, [steps]),
        },
        [steps],
    )


steps = {}
for split, name in IDS.items():
    dataset = minari.load_dataset(name)
    buffer = TensorDictReplayBuffer(storage=LazyTensorStorage(dataset.total_steps), batch_size=64)
    for episode in dataset:
        buffer.extend(transitions(episode))
    every = buffer[:]
    ends = (np.flatnonzero(every["next", "done"].numpy()) + 1).tolist()
    parts = (every[start:end] for start, end in zip([0, *ends[:-1]], ends, strict=True))
    episodes = (
        Episode(
            np.concatenate([part["observation"], part["next", "observation"][-1:]]),
            part["action"],
            part["next", "reward"][:, 0],
            bool(part["next", "terminated"][-1, 0]),
        )
        for part in parts
    )
    steps[split] = compare(episodes, split)
    if split == "train":
        torch.manual_seed(0)
        batches = (buffer.sample() for _ in range(30))
        trained = fitted((b["observation"].permute(0, 3, 1, 2) / 255, b["action"]) for b in batches)

with tempfile.TemporaryDirectory() as root:
    options = {"root": root, "load_from_local_minari": True, "download": "force"}
    found = MinariExperienceReplay(IDS["train"], batch_size=64, **options)[:]
zeros = not found["observation"].any()
report(
    ["torchrl", "tensordict", "minari", "torch"],
    f"{sum(steps.values()):,} steps, given episode by episode; `MinariExperienceReplay` reads "
    f"{'zeros' if zeros else 'them, too'}",
    trained,
)

"""Minari: load, sample, filter and split, and replay every episode in the recovered environment.

As client `minari-release` it first downloads the datasets from the Hub with Minari's command line.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import minari
import numpy as np
from comparing import CLIENT, FOLDER, IDS, Episode, compare, report

released = CLIENT == "minari-release"
if released:
    os.environ["MINARI_REMOTE"] = "hf://user"
    os.environ["MINARI_DATASETS_PATH"] = str(FOLDER / "downloaded")

steps = {}
for split, name in IDS.items():
    if released:
        name = name.replace("labyrinth/", "labyrinth-minari/")
        download = [str(Path(sys.executable).with_name("minari")), "download", "--force", name]
        subprocess.run(download, check=True, input="y\n", text=True)
    dataset = minari.load_dataset(name)
    episodes = (Episode(e.observations, e.actions, e.rewards, e.terminations[-1]) for e in dataset)
    steps[split] = compare(episodes, split)
    environment = dataset.recover_environment()
    kept = dataset.storage.get_episode_metadata(dataset.episode_indices)
    for episode, facts in zip(dataset, kept, strict=True):
        observation, _ = environment.reset(options=facts["options"])
        seen, rewards, ends = [observation], [], []
        for action in episode.actions:
            observation, reward, *end, _ = environment.step(action)
            seen.append(observation)
            rewards.append(reward)
            ends.append(end)
        assert np.array_equal(seen, episode.observations)
        assert np.array_equal(np.float32(rewards), episode.rewards)
        assert np.array_equal(np.transpose(ends), [episode.terminations, episode.truncations])
    assert len(list(dataset.sample_episodes(5))) == 5
    assert len(dataset.filter_episodes(lambda episode: episode.truncations[-1])) < len(dataset)
    assert [len(part) for part in minari.split_dataset(dataset, [60, 40], seed=0)] == [60, 40]
report(
    ["minari", "gymnasium", "h5py"],
    f"{sum(steps.values()):,} steps, each replayed in the recovered environment",
)

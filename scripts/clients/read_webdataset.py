"""WebDataset: a tar that its writer makes of what our loader yields, and its reader reads."""

from __future__ import annotations

import webdataset as wds
from comparing import CONFIG, DATA, FOLDER, Episode, compare, report

from labyrinth_core import load_episodes

path = str(FOLDER / "train.tar")
with wds.TarWriter(path) as tar:
    for number, episode in enumerate(load_episodes(DATA, CONFIG, split="train")):
        about = {"labyrinth": episode.info, "terminated": bool(episode.terminated)}
        arrays = {"obs": episode.observations, "acts": episode.actions, "rews": episode.rewards}
        files = {f"{key}.npy": value for key, value in arrays.items()}
        tar.write({"__key__": f"{number:06d}", "json": about, **files})

found = wds.WebDataset(path, shardshuffle=False).decode()
steps = compare(
    (Episode(e["obs.npy"], e["acts.npy"], e["rews.npy"], e["json"]["terminated"]) for e in found),
    "train",
)
report(["webdataset"], f"{steps:,} steps")

"""LeRobot: compare the dataset and the table of episodes, and train with a DataLoader.

As client `lerobot-release` it reads the split train from the Hub, given only the id.
"""

from __future__ import annotations

import shutil
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pyarrow.parquet as pq
import torch
from comparing import CLIENT, CONFIG, DATA, EXPORTS, IDS, Episode, compare, fitted, report
from lerobot.datasets.lerobot_dataset import LeRobotDataset

steps = {}
datasets = {
    split: LeRobotDataset(name, root=EXPORTS / "lerobot" / name) for split, name in IDS.items()
}
if CLIENT == "lerobot-release":
    datasets = {"train": LeRobotDataset("user/labyrinth-lerobot")}
for split, dataset in datasets.items():

    def episode(row, dataset=dataset) -> Episode:
        """Return the episode of a row of the table of episodes."""
        frames = [dataset[n] for n in range(row["dataset_from_index"], row["dataset_to_index"])]
        pictures = torch.stack([frame["observation.image"] for frame in frames])
        actions = [frame["action"].item() for frame in frames]
        assert actions[-1] == -1
        return Episode(
            (pictures * 255).round().byte().permute(0, 2, 3, 1).numpy(),
            actions[:-1],
            [frame["next.reward"].numpy() for frame in frames[:-1]],
            not frames[-1]["next.truncated"].item(),
        )

    steps[split] = compare(map(episode, dataset.meta.episodes), split)
    ours = pq.read_table(DATA / CONFIG / "labyrinths.parquet").to_pylist()
    ours = [row for row in ours if row["split"] == split for _ in range(row["episodes"])]
    for theirs, row in zip(dataset.meta.episodes, ours, strict=True):
        assert {name: theirs[name] for name in row} == row

if CLIENT == "lerobot":  # Append an episode to a copy with LeRobot, and read it with ours.
    with TemporaryDirectory() as folder:
        copy = Path(shutil.copytree(datasets["train"].root, f"{folder}/copy"))
        longer = LeRobotDataset.resume(IDS["train"], root=copy)
        first = datasets["train"][0]
        frame = {
            name: first[name].numpy().reshape(1)
            for name in ("action", "next.reward", "next.done", "next.truncated")
        }
        frame["observation.image"] = np.zeros(longer.features["observation.image"]["shape"], "u1")
        for _ in range(3):
            longer.add_frame(frame | {"task": first["task"]})
        longer.save_episode()
        longer.finalize()
        read = LeRobotDataset(IDS["train"], root=copy)
        assert len(read) == len(datasets["train"]) + 3
        assert torch.equal(read[0]["observation.image"], first["observation.image"])

dataset = datasets["train"]
acting = [n for n, action in enumerate(dataset.hf_dataset["action"]) if action >= 0]
loader = torch.utils.data.DataLoader(
    torch.utils.data.Subset(dataset, acting),
    batch_size=64,
    shuffle=True,
    generator=torch.Generator().manual_seed(0),
)
batches = ((batch["observation.image"], batch["action"]) for _ in range(3) for batch in loader)
report(
    ["lerobot", "datasets", "torch"],
    f"{sum(steps.values()):,} steps, and the table of episodes",
    fitted(batches),
)

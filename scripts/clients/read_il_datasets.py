"""IL-Datasets, by the benchmark's authors: read a release directly from the Hub."""

from __future__ import annotations

import numpy as np
import torch
from comparing import EXPORTS, IDS, fitted, report
from imitation_datasets.dataset import BaselineDataset

pairs = 0
for split in IDS:
    # Pictures of the release have 600 x 600 pixels, so only 1 in 30 pairs is compared.
    release = BaselineDataset("user/labyrinth", source="huggingface", hf_split=split)
    full = dict(np.load(EXPORTS.parent / "reference" / f"{split}-600.npz"))
    assert np.array_equal(release.actions[:, 0], full["actions"])
    for number, place in enumerate(full["places"]):
        for key, picture in zip(("states", "next_states"), release[place][::2], strict=False):
            pixels = (picture * 255).round().byte().permute(1, 2, 0)
            assert np.array_equal(pixels, full[key][number])
    pairs += len(release)

loader = torch.utils.data.DataLoader(
    BaselineDataset("user/labyrinth", source="huggingface", hf_split="train"),
    batch_size=64,
    shuffle=True,
    generator=torch.Generator().manual_seed(0),
)
batches = (
    (torch.nn.functional.interpolate(states, size=64, mode="area"), actions[:, 0])
    for _ in range(3)
    for states, actions, *_ in loader
)
report(
    ["IL-Datasets", "datasets", "torch"],
    f"{pairs:,} pairs of a release on a Hub, of which the pictures of 1 in 30",
    fitted(batches),
)

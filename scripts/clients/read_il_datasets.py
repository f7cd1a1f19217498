"""IL-Datasets, of the benchmark's authors: a release on the Hub as it is, and the npz export."""

from __future__ import annotations

import numpy as np
import torch
from comparing import EXPORTS, IDS, Episode, compare, expected, fitted, report
from imitation_datasets.dataset import BaselineDataset, IRLDataset


def episodes(data: IRLDataset, split: str):
    """Yield the episodes of npz; the library keeps of each all pairs of consecutive states."""
    step = 0
    for ours in expected(split):
        part = slice(step, step + len(ours.actions))
        states = np.concatenate([data.states[part], data.next_states[part][-1:]])
        yield Episode(states, data.actions[part][:, 0], data.rewards[part])
        step = part.stop
    assert step == len(data)


steps = pairs = 0
for split, name in IDS.items():
    data = IRLDataset(EXPORTS / "npz" / name / "episodes.npz")
    steps += compare(episodes(data, split), split)

    # Pictures of the release have 600 x 600 pixels, so that 1 in 30 pairs is compared.
    release = BaselineDataset("user/labyrinth", source="huggingface", hf_split=split)
    full = dict(np.load(EXPORTS.parent / "reference" / f"{split}-600.npz"))
    assert np.array_equal(release.actions[:, 0], full["actions"])
    for number, place in enumerate(full["places"]):
        for key, picture in zip(("states", "next_states"), release[place][::2], strict=False):
            pixels = (picture * 255).round().byte().permute(1, 2, 0)
            assert np.array_equal(pixels, full[key][number])
    pairs += len(release)

loader = torch.utils.data.DataLoader(
    IRLDataset(EXPORTS / "npz" / IDS["train"] / "episodes.npz"),
    batch_size=64,
    shuffle=True,
    generator=torch.Generator().manual_seed(0),
)
batches = (
    (states.permute(0, 3, 1, 2) / 255, actions[:, 0])
    for _ in range(3)
    for states, actions, *_ in loader
)
report(
    ["IL-Datasets", "datasets", "torch"],
    f"{pairs:,} pairs of a release on a Hub, of which the pictures of 1 in 30; {steps:,} steps of "
    "the npz export",
    fitted(batches),
)

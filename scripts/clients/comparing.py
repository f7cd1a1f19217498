"""Shared code of the scripts of this folder: the episodes that our loader returns, and the report.

`scripts/check_clients.py` runs each script in the virtual environment of its client, with the
folder of the check and the name of the client as its arguments.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterable, Iterator
from importlib.metadata import version
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

FOLDER = Path(sys.argv[1])
CLIENT = sys.argv[2]
DATA = FOLDER / "data"
EXPORTS = FOLDER / "exports"
CONFIG = "5x5"
SPLITS = ("train", "random")
IDS = {split: f"labyrinth/{CONFIG}/{split}-v0" for split in SPLITS}


class Episode(NamedTuple):
    """One episode, as read by a client or by our loader."""

    observations: Any
    """The T + 1 pictures, uint8 (T + 1, 64, 64, 3)."""
    actions: Any
    rewards: Any
    """The T rewards; None if the client does not read them."""
    terminated: Any = None
    """Whether it ends on the goal; None if the client does not say."""


def expected(split: str) -> Iterator[Episode]:
    """Yield the episodes of a split that `load_episodes` returns."""
    arrays = np.load(FOLDER / "reference" / f"{split}.npz")
    state = step = 0
    observations, actions, rewards = (arrays[k] for k in ("observations", "actions", "rewards"))
    for length, terminated in zip(arrays["lengths"], arrays["terminated"], strict=True):
        states, steps = slice(state, state + length + 1), slice(step, step + length)
        yield Episode(observations[states], actions[steps], rewards[steps], bool(terminated))
        state, step = states.stop, steps.stop


def compare(found: Iterable[Episode], split: str) -> int:
    """Compare each value with ours, and return the number of transitions; exit if one differs."""
    count = 0
    for number, (theirs, ours) in enumerate(zip(found, expected(split), strict=True)):
        for name, value, own in zip(Episode._fields, theirs, ours, strict=True):
            if value is None:
                continue
            value = np.asarray(value)
            same_type = name != "observations" or value.dtype == np.uint8
            if not same_type or not np.array_equal(value, own):
                sys.exit(f"{split}: episode {number}: {name} differ from those of our loader")
        count += len(ours.actions)
    return count


def fitted(batches: Iterable[tuple[Any, Any]], steps: int = 30) -> str:
    """Train a small network with Adam, and say in words how the loss fell.

    Args:
        batches: Pictures, float from 0 to 1, (B, 3, 64, 64), and actions, int64 (B,).
        steps: The number of batches to train on.
    """
    import torch
    from torch import nn

    torch.manual_seed(0)
    layers = [nn.Conv2d(3, 16, 8, 4), nn.ReLU(), nn.Conv2d(16, 32, 4, 2), nn.ReLU(), nn.Flatten()]
    network = nn.Sequential(*layers, nn.LazyLinear(4))
    optimizer = None
    losses = []
    for pictures, actions in islice(batches, steps):
        loss = nn.functional.cross_entropy(network(pictures), actions)
        optimizer = optimizer or torch.optim.Adam(network.parameters(), 1e-3)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        losses.append(loss.item())
    return fall(losses)


def fall(losses: list[float]) -> str:
    """Say in words how the losses fell; exit if they did not fall."""
    few = max(1, len(losses) // 5)
    first, last = np.mean(losses[:few]), np.mean(losses[-few:])
    if not last < first:
        sys.exit(f"the loss did not fall: {first:.2f}, then {last:.2f}")
    return f"{len(losses)} steps, loss {first:.2f} to {last:.2f}"


def report(packages: Iterable[str], compared: str, trained: str = "") -> None:
    """Print the results of the check as JSON, in the last line."""
    versions = {package: version(package) for package in packages}
    print(json.dumps({"versions": versions, "compared": compared, "trained": trained}))

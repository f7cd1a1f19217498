"""Findings about a dataset, as the report finds them beside it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from labyrinth_core.data.loader import load_episodes
from labyrinth_core.data.manifest import ANALYSIS, Manifest
from labyrinth_core.data.splits import BASE_SPLITS
from labyrinth_core.evaluation.baselines import BASELINES

METHOD = "bc-<b>cnn"
"""A name that would be an element of the page, if it were taken for markup."""


def ids_of(folder: Path, split: str) -> list[str]:
    episodes = load_episodes(folder.parent, folder.name, split=split, observation="vector")
    return list(dict.fromkeys(f"{episode.labyrinth_id:016x}" for episode in episodes))


def analyse(folder: Path) -> dict[str, Any]:
    """Leave an analysis that finds one structure of train in test, and return it."""
    train, test = ids_of(folder, "train"), ids_of(folder, "test")
    pair = {
        "first": "train",
        "second": "test",
        "equal": {test[0]: train[0]},
        "mirrored": {test[0]: train[0]},
        "symmetric": {test[0]: train[0], test[1]: train[1]},
        "same_route": {},
        "nearest": {test[0]: [train[0], 0], test[1]: [train[1], 4], test[2]: [train[1], 9]},
        "within": {"1": 1, "2": 1, "3": 1},
        "spread": "0, 4",
    }
    shift = {
        "measure": "route_length",
        "first": "train",
        "second": "test",
        "labyrinths": [len(train), len(test)],
        "distance": 0.25,
        "effect": None,
        "p_value": 0.001,
        "corrected": 0.004,
    }
    content = {
        "format": 1,
        "fingerprint": Manifest.read(folder).fingerprint,
        "leakage": {
            "labyrinths": {"train": len(train), "test": len(test), "s0": 8},
            "repeated": {"train": 0, "test": 0, "s0": 0},
            "pairs": [pair],
            "strangers": {"s0": []},
            "cut": 0,
        },
        "shift": {"permutations": 999, "measures": [shift]},
    }
    (folder / ANALYSIS).write_text(json.dumps(content))
    return content


def evaluate(folder: Path, run_dir: Path, seed: int = 0) -> list[str]:
    """Leave an evaluation that failed on two labyrinths of test, and return their ids.

    Another seed fails on one of them and on another one.
    """
    ids = {split: ids_of(folder, split) for split in BASE_SPLITS if split != "random"}
    failed = {split: ids[split][seed : seed + 2] if split == "test" else [] for split in ids}
    splits = {
        split: {
            "labyrinths": len(ids[split]),
            "sr": 1 - len(failed[split]) / len(ids[split]),
            "sr_interval": [0.4, 1.0],
            "aer": -0.25 - seed,
            "aer_std": 2.0,
            "aer_interval": [-2.0, 0.5],
            "path_efficiency": None,
            "accuracy_on_demonstrations": 0.9,
            "accuracy_elsewhere": 0.5,
            "failures": {"loop": len(failed[split])} if failed[split] else {},
            "by_distance": {"4": [len(ids[split]) - len(failed[split]), len(ids[split])]},
            "outcomes": "".join("l" if each in failed[split] else "s" for each in ids[split]),
            "moves": [4] * len(ids[split]),
            "failed": failed[split],
        }
        for split in ids
    }
    figures = {"sr": 0.1, "aer": -3.5, "aer_std": 1.0}
    content = {
        "format": 1,
        "run": {
            "method": "bc",
            "encoder": "cnn",
            "pool_stride": 1,
            "protocol": "default",
            "seed": seed,
            "config": folder.name,
            "fingerprint": Manifest.read(folder).fingerprint,
            "settings": {},
        },
        "training": {
            "epochs": 7,
            "seconds": 90.5,
            "selected": {"epoch": 5},
            "computed": {"device": "cpu"},
        },
        "splits": splits,
        "baselines": {split: dict.fromkeys(BASELINES, figures) for split in ids},
    }
    path = run_dir / folder.name / f"{METHOD}-seed{seed}" / "evaluation.json"
    path.parent.mkdir(parents=True)
    path.write_text(json.dumps(content))
    return failed["test"]

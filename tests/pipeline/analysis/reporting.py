"""Findings about a dataset, as the report finds them beside it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from pipeline.loader import load_episodes
from pipeline.manifest import ANALYSIS, Manifest

RUN_NAME = "bc-<b>cnn-seed0"
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


def evaluate(folder: Path, run_dir: Path) -> list[str]:
    """Leave an evaluation that failed on two labyrinths of test, and return their ids."""
    failed = ids_of(folder, "test")[:2]
    scores = {
        "labyrinths": 8,
        "sr": 0.75,
        "sr_interval": [0.4, 1.0],
        "aer": -0.25,
        "aer_std": 2.0,
        "path_efficiency": None,
        "accuracy_on_demonstrations": 0.9,
        "accuracy_elsewhere": 0.5,
        "failures": {"loop": 2},
        "failed": failed,
    }
    content = {
        "format": 1,
        "run": {
            "method": "bc",
            "config": folder.name,
            "fingerprint": Manifest.read(folder).fingerprint,
        },
        "splits": {"test": scores},
        "baselines": {"test": {"random": {"sr": 0.1, "aer": -3.5, "aer_std": 1.0}}},
    }
    path = run_dir / folder.name / RUN_NAME / "evaluation.json"
    path.parent.mkdir(parents=True)
    path.write_text(json.dumps(content))
    return failed

"""Findings about a dataset, as the report finds them beside it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

import labyrinth_core
from labyrinth_core import load_episodes
from labyrinth_core.data import SPLITS, Manifest
from labyrinth_core.evaluation import KnownDataset, Results
from labyrinth_core.evaluation.scores import Episodes, Scores
from labyrinth_core.world import RULES
from support.submitted import keep, of_run

METHOD = "bc-cnn"
"""The name of the method whose runs are left."""


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
    (folder / Manifest.ANALYSIS).write_text(json.dumps(content))
    return content


def evaluate_own(folder: Path, run_dir: Path, name: str, author: str = "") -> None:
    """Leave results on test of a policy that no run made, which goes up for ever."""
    results = labyrinth_core.evaluate(
        lambda shown: np.zeros(len(shown), int), folder.parent, folder.name, splits=["test"]
    )
    results.save(run_dir / folder.name / "mine" / "results.json", name=name, author=author)


def evaluate(folder: Path, run_dir: Path, seed: int = 0) -> list[str]:
    """Leave results of a run that failed on two labyrinths of test, and return their ids.

    Another seed fails on one of them and on another one.
    """
    splits, failed = {}, []
    known = KnownDataset.read(str(folder.parent), folder.name)
    for split in SPLITS.base:
        if split == "random":
            continue
        right = known.split(split)
        outcomes = np.full(len(right.distance), "solved")
        if split == "test":
            outcomes[seed : seed + 2] = "loop"
        cells = known.data.manifest.config.height * known.data.manifest.config.width
        moves = np.where(outcomes == "solved", right.distance, RULES.step_limit * cells)
        episodes = Episodes(outcomes, moves, cells)
        about = right.labyrinth_ids, right.distance, 1.0, 0.0, right.known_route
        splits[split] = Scores(episodes, *about)
        failed += splits[split].failed
    results = Results(
        dataset=str(folder.parent),
        revision=None,
        config=folder.name,
        fingerprint=known.fingerprint,
        observation="image",
        image_size=64,
        way="look-ups",
        episodes=1,
        seed=seed,
        splits=splits,
        baselines={},
    )
    keep(of_run(results, seed=seed), run_dir)
    return failed

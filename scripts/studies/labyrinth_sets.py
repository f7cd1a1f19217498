"""Sets of labyrinths on which ablate.py and generalise.py evaluate a policy.

They are the splits, and labyrinths outside the dataset. The results are kept as JSON.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from labyrinth_core.data.storage import write_text
from labyrinth_core.evaluation.labyrinth_arrays import load_arrays
from labyrinth_core.evaluation.scores import EVALUATED_SPLITS
from labyrinth_core.world.labyrinth import Labyrinth, Structure
from labyrinth_core.world.random_labyrinth import change_start_and_goal
from labyrinth_core.world.sampling import default_open_walls, sample_structures
from labyrinth_core.world.tasks import default_start_and_goal, place

SEED = 1_000_000
"""The seed of the starts, goals and structures that runs are tested on."""


def labyrinth_sets(
    source: str | Path,
    config: str,
    *,
    sides: Sequence[int] = (),
    labyrinths: int = 100,
) -> Iterator[tuple[str, list[Labyrinth]]]:
    """Yield sets of labyrinths by name: the splits, new starts and goals, and fresh labyrinths.

    Args:
        source: Folder with the dataset, or its id on the Hub.
        config: Such as `5x5`.
        sides: Sides of larger fresh labyrinths; fresh ones of the dataset's size always come.
        labyrinths: The number of fresh labyrinths of each size, whose structures are not in train.
    """
    rng = np.random.default_rng(SEED)
    splits = {
        split: list(load_arrays(source, config, split, observation="vector").labyrinths)
        for split in EVALUATED_SPLITS
    }
    yield from splits.items()
    for split in ("validation", "test"):
        yield f"{split}, new ends", [change_start_and_goal(each, rng) for each in splits[split]]
    like = splits["train"][0]
    known = {each.structure.canonical() for each in splits["train"]}
    shapes = {"fresh": (like.structure.height, like.structure.width)}
    shapes |= {f"fresh {side}x{side}": (side, side) for side in sides}
    for name, shape in shapes.items():
        yield name, list(islice(_fresh(shape, like, known, rng), labyrinths))


def _fresh(
    shape: tuple[int, int], like: Labyrinth, known: set[Structure], rng: np.random.Generator
) -> Iterator[Labyrinth]:
    """Yield labyrinths of a shape and of the task of `like`, without the known structures."""
    walls = default_open_walls(*shape)
    start, goal = default_start_and_goal(*shape)
    for structure in sample_structures(*shape, rng, algorithm="wilson", open_walls=walls):
        if structure.canonical() in known:
            continue
        try:
            yield place(structure, start, goal, like.task, rng)
        except ValueError:  # It cannot hold the task.
            continue


def write_results(
    path: Path, about: Mapping[str, Any], solved: Mapping[str, Sequence[bool]]
) -> None:
    """Write a description of a run, and which labyrinths of each set it solved."""
    digits = {name: "".join(str(int(each)) for each in which) for name, which in solved.items()}
    path.parent.mkdir(parents=True, exist_ok=True)
    write_text(path, json.dumps({**about, "solved": digits}, indent=1) + "\n")

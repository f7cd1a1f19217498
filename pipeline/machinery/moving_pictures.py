"""Moving pictures of what a policy does, each beside an optimal episode in the same labyrinth."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.data.storage import write_bytes
from labyrinth_core.evaluation.attempts import attempts
from labyrinth_core.evaluation.labyrinth_arrays import LabyrinthArrays
from labyrinth_core.evaluation.stepping import Player
from labyrinth_core.language.text import labyrinth_id
from labyrinth_core.pictures.animation import beside, frames_of, gif
from labyrinth_core.world.rollout import replay
from labyrinth_core.world.solver import shortest_route

FOLDER = "attempts"
"""The folder of the pictures, in that of the results."""


def write_attempts(
    folder: Path,
    player: Player,
    arrays: LabyrinthArrays,
    solved: NDArray[np.bool_],
    count: int,
    seed: int,
) -> list[Path]:
    """Write the first labyrinths that were not solved, then the first that were; return the files.

    Args:
        folder: Where the folder of the pictures is made.
        player: The policy, as it is asked.
        arrays: The labyrinths of a split, and how they are observed.
        solved: Whether they were solved, shape (labyrinths,).
        count: The number of pictures, if there are as many labyrinths.
        seed: Settles which of several optimal episodes is shown.

    Raises:
        PolicyError: The policy raises an error, or answers with anything but actions.
    """
    chosen = [arrays.labyrinths[place] for place in np.argsort(solved, kind="stable")[:count]]
    tried = attempts(player, chosen, arrays.spec)
    paths = []
    for labyrinth, episode in zip(chosen, tried, strict=True):
        optimal = replay(labyrinth, shortest_route(labyrinth, np.random.default_rng(seed)))
        path = folder / FOLDER / f"{labyrinth_id(labyrinth)}.gif"
        path.parent.mkdir(parents=True, exist_ok=True)
        write_bytes(path, gif([beside(frames_of(episode), frames_of(optimal))]))
        paths.append(path)
    return paths

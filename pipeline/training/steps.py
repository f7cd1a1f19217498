"""The transitions of a dataset's episodes, as numbers of states: s, a, s'."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.data.errors import DatasetError
from labyrinth_core.data.loader import load_episodes
from labyrinth_core.evaluation.labyrinth_arrays import LabyrinthArrays


class Steps(NamedTuple):
    """N transitions; states are numbered as in `LabyrinthArrays`."""

    states: NDArray[np.int64]
    """The state acted in, shape (N,)."""
    actions: NDArray[np.int64]
    """The action taken, shape (N,)."""
    next_states: NDArray[np.int64]
    """The state that the action led to, shape (N,)."""


def load_steps(
    source: str | Path,
    config: str,
    split: str,
    arrays: LabyrinthArrays,
    *,
    revision: str | None = None,
) -> Steps:
    """Return the transitions of all episodes of a split, in order.

    Args:
        source: Folder with the dataset, or its id on the Hub.
        config: Such as `5x5`.
        split: A split whose labyrinths are in `arrays`: `train`, or `random` for those of `train`.
        arrays: The labyrinths, with their states numbered.
        revision: Branch, tag or commit on the Hub.

    Raises:
        DatasetError: There is no such split, or one of its labyrinths is not in `arrays`.
    """
    first = dict(zip(arrays.labyrinth_ids.tolist(), arrays.initial.tolist(), strict=True))
    found = []
    for episode in load_episodes(
        source, config, split=split, observation="vector", revision=revision
    ):
        if episode.labyrinth_id not in first:
            raise DatasetError(
                f"split={split}: labyrinth {episode.labyrinth_id:016x} is none of those trained on"
            )
        states = [first[episode.labyrinth_id]]
        for action in episode.actions.tolist():
            states.append(int(arrays.next_state[states[-1], action]))
        found.append((np.array(states[:-1]), episode.actions, np.array(states[1:])))
    return Steps(*map(np.concatenate, zip(*found, strict=True)))

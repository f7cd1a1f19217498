"""What a dataset's episodes are made of, as numbers of states: s, a, s'."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.data.errors import DatasetError
from labyrinth_core.data.loader import load_episodes
from labyrinth_core.evaluation.labyrinth_arrays import LabyrinthArrays


class Steps(NamedTuple):
    """Steps in the labyrinths of `LabyrinthArrays`; the last state of an episode begins none."""

    states: NDArray[np.int64]
    """Number of the state acted in, shape (N,)."""
    actions: NDArray[np.int64]
    """Shape (N,)."""
    next_states: NDArray[np.int64]
    """Number of the state that the action led to, shape (N,)."""


def steps_from(worlds: LabyrinthArrays, first: int, actions: NDArray[np.int64]) -> Steps:
    """Return the steps of an episode that begins in a state."""
    states = [first]
    for action in actions.tolist():
        states.append(int(worlds.next_state[states[-1], action]))
    numbers = np.array(states)
    return Steps(numbers[:-1], actions, numbers[1:])


def load_steps(
    source: str | Path,
    config: str,
    split: str,
    worlds: LabyrinthArrays,
    *,
    revision: str | None = None,
) -> Steps:
    """Return the steps of all episodes of a split, in order.

    Args:
        source: Folder with the dataset, or its id on the Hub.
        config: Such as `5x5`.
        split: One whose labyrinths are those of `worlds`: train, or random beside train.
        worlds: Where the steps are made.
        revision: Branch, tag or commit on the Hub.

    Raises:
        DatasetError: There is no such split, or a labyrinth of it is not in `worlds`.
    """
    first = dict(zip(worlds.labyrinth_ids.tolist(), worlds.initial.tolist(), strict=True))
    found = []
    for episode in load_episodes(
        source, config, split=split, observation="vector", revision=revision
    ):
        if episode.labyrinth_id not in first:
            raise DatasetError(
                f"split={split}: labyrinth {episode.labyrinth_id:016x} is none of those trained on"
            )
        found.append(steps_from(worlds, first[episode.labyrinth_id], episode.actions))
    return Steps(*map(np.concatenate, zip(*found, strict=True)))

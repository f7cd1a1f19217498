"""Rows grouped into episodes, which are replayed and observed."""

from __future__ import annotations

from collections.abc import Generator, Iterable
from functools import lru_cache
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.data.columns import NO_ACTION
from labyrinth_core.data.errors import DatasetError
from labyrinth_core.data.observations import ObservationSpec
from labyrinth_core.data.source import RawRow
from labyrinth_core.data.transitions import LoadedEpisode
from labyrinth_core.language.text import labyrinth_id, parse, without_agent
from labyrinth_core.world.dynamics import initial, state_index, transition
from labyrinth_core.world.labyrinth import Labyrinth
from labyrinth_core.world.rollout import Episode, replay
from labyrinth_core.world.solver import optimal_actions


def episodes_of(
    rows: Iterable[RawRow],
    spec: ObservationSpec,
    part: int = 0,
    parts: int = 1,
) -> Generator[LoadedEpisode]:
    """Yield the episodes of rows in order, which may cross the ends of shards and batches.

    Args:
        rows: The rows.
        spec: What is observed.
        part: Which of the parts to yield, from 0.
        parts: The number of parts that the episodes are dealt out to, one after the other.

    Raises:
        DatasetError: The rows do not make episodes.
    """
    for episode_rows in islice(grouped(rows), part, None, parts):
        number, episode = _replayed(episode_rows)
        yield LoadedEpisode(
            labyrinth_id=number,
            info=episode_rows[0].info,
            observations=spec.observe(episode, [row.png for row in episode_rows]),
            actions=np.array([row.actions for row in episode_rows[:-1]], np.int64),
            rewards=np.array([row.rewards for row in episode_rows[:-1]], np.float32),
            terminated=episode.terminated,
        )


def _replayed(rows: list[RawRow]) -> tuple[int, Episode]:
    """Return the labyrinth id and the episode of rows; raise DatasetError if they make none."""
    try:
        labyrinth, number = parse_info(rows[0].info)
        return number, replay(labyrinth, [row.actions for row in rows[:-1]])
    except ValueError as error:
        reason = str(error).partition("\n")[0]
        raise DatasetError(f"an episode cannot be replayed: {reason}") from error


def optimal_actions_of(rows: Iterable[RawRow]) -> NDArray[np.bool_]:
    """Return which actions begin a shortest route in each state that is acted in, shape (N, 4).

    Raises:
        DatasetError: The rows do not make episodes.
    """
    found = []
    for episode_rows in grouped(rows):
        info = episode_rows[0].info
        labyrinth, optimal = _solved(without_agent(info))
        state = initial(parse_info(info)[0])
        places = []
        for row in episode_rows[:-1]:
            places.append(state_index(labyrinth, state))
            state = transition(labyrinth, state, row.actions)
        found.append(optimal[places])
    return np.concatenate(found)


@lru_cache(maxsize=1)
def _solved(info: str) -> tuple[Labyrinth, NDArray[np.bool_]]:
    """Return a labyrinth and its optimal actions; cached, as episodes often share one."""
    labyrinth, _ = parse_info(info)
    return labyrinth, optimal_actions(labyrinth)


def grouped(rows: Iterable[RawRow]) -> Generator[list[RawRow]]:
    """Yield the rows of each episode; the last row takes no action.

    Raises:
        DatasetError: The rows do not make episodes.
    """
    pending: list[RawRow] = []
    for number, row in enumerate(rows):
        if not pending and not row.episode_starts:
            raise DatasetError(f"row {number} episode_starts: False where an episode must begin")
        if pending and (row.episode_starts or row.info != pending[0].info):
            raise DatasetError(f"row {number}: an episode ends without its last row, actions=-1")
        pending.append(row)
        if row.actions == NO_ACTION:
            if len(pending) == 1:
                raise DatasetError(f"row {number} actions: -1 in the first row of an episode")
            yield pending
            pending = []
    if pending:
        raise DatasetError("the last episode ends without its last row, actions=-1")


@lru_cache(maxsize=1)
def parse_info(info: str) -> tuple[Labyrinth, int]:
    """Return a labyrinth and its id; cached, as consecutive episodes often share a labyrinth."""
    labyrinth = parse(info)
    return labyrinth, int(labyrinth_id(labyrinth), 16)

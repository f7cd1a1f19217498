"""Episodes as the states of their labyrinths that they go through; no pictures."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

from labyrinth_core.data.episodes import grouped
from labyrinth_core.data.errors import DatasetError
from labyrinth_core.data.manifest import Shard
from labyrinth_core.data.source import read_rows
from labyrinth_core.data.storage import AnyPath
from labyrinth_core.language.text import parse
from labyrinth_core.world.dynamics import initial, state_index, transition_table
from labyrinth_core.world.labyrinth import Labyrinth
from labyrinth_core.world.solver import distances


class Walk(NamedTuple):
    """An episode."""

    labyrinth: Labyrinth
    is_first: bool
    """Whether it is the first of its labyrinth."""
    moves: int
    """Of a shortest route in its labyrinth."""
    states: Sequence[int]
    """The numbers of the T + 1 states, as in `dynamics`; modulo the cells, where the agent is."""
    actions: Sequence[int]
    """The T actions."""


def walks(episodes: Iterable[tuple[str, Sequence[int]]]) -> Iterator[Walk]:
    """Yield episodes with their states.

    Args:
        episodes: The text of its labyrinth, and the actions, of each; those of a labyrinth
            follow one another.

    Raises:
        ValueError: A text is no labyrinth.
        IndexError: A number is no action.
    """
    before = None
    for info, actions in episodes:
        is_first = info != before
        if is_first:
            before = info
            labyrinth = parse(info)
            table = transition_table(labyrinth)
            start = state_index(labyrinth, initial(labyrinth))
            moves = distances(labyrinth, table)[start]
        states = [start]
        for action in actions:
            states.append(table[states[-1]][action])
        yield Walk(labyrinth, is_first, moves, states, actions)


def walks_of(folder: AnyPath, shard: Shard) -> Iterator[Walk]:
    """Yield the episodes of a shard.

    Raises:
        DatasetError: The file is missing, damaged, or its rows do not make episodes.
    """
    rows = grouped(read_rows(folder, [shard], pictures=False))
    try:
        yield from walks((group[0].info, [row.actions for row in group[:-1]]) for group in rows)
    except (ValueError, IndexError) as error:
        reason = str(error).partition("\n")[0]
        raise DatasetError(f"{folder / shard.path} cannot be read: {reason}") from error

"""A dataset's episodes as sequences of states and actions, read without their pictures."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

from labyrinth_core.data.dataset import Part
from labyrinth_core.data.episodes import grouped
from labyrinth_core.data.errors import DatasetError, one_line
from labyrinth_core.data.manifest import Shard
from labyrinth_core.data.storage import AnyPath
from labyrinth_core.language.text import parse
from labyrinth_core.world.dynamics import initial, state_index
from labyrinth_core.world.labyrinth import Labyrinth
from labyrinth_core.world.solver import table_and_distances


class Route(NamedTuple):
    """The route of one episode."""

    labyrinth: Labyrinth
    is_first: bool
    """Whether it is the labyrinth's first route."""
    shortest: int
    """The number of moves of a shortest route in the labyrinth, from its start."""
    states: Sequence[int]
    """The T + 1 states visited, as `dynamics` numbers them: modulo the cells, the agent's cell."""
    actions: Sequence[int]
    """The T actions taken."""
    returned: float
    """The sum of the episode's rewards."""


def routes(episodes: Iterable[tuple[str, Sequence[int], float]]) -> Iterator[Route]:
    """Yield the routes of episodes.

    Args:
        episodes: The text, the actions and the return of each, grouped by labyrinth.

    Raises:
        ValueError: A text does not describe a labyrinth, or an action is negative.
        IndexError: An action is too large.
    """
    before = None
    for text, actions, returned in episodes:
        is_first = text != before
        if is_first:
            before = text
            labyrinth = parse(text)
            table, distances = table_and_distances(labyrinth)
            start = state_index(labyrinth, initial(labyrinth))
            shortest = distances[start]
        if min(actions, default=0) < 0:
            raise ValueError(f"{min(actions)} is not an action")
        states = [start]
        for action in actions:
            states.append(table[states[-1]][action])
        yield Route(labyrinth, is_first, shortest, states, actions, returned)


def routes_of(folder: AnyPath, shard: Shard) -> Iterator[Route]:
    """Yield the routes of a shard, reading one row group at a time.

    Raises:
        DatasetError: The file is missing or damaged, or its rows do not form episodes.
    """
    path = folder / shard.path
    groups = grouped(Part(folder, [shard]).rows(pictures=False))
    try:
        yield from routes(episode for group in groups for episode in group.each())
    except (ValueError, IndexError, DatasetError) as error:
        if str(path) in str(error):  # From `Part.rows`.
            raise
        raise DatasetError(f"{path} cannot be read: {one_line(error)}") from error

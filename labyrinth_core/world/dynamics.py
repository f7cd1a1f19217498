"""`replay` as a function, for code written before `Labyrinth.replay`."""

from __future__ import annotations

from collections.abc import Iterable

from labyrinth_core.world.labyrinth import Episode, Labyrinth


def replay(labyrinth: Labyrinth, actions: Iterable[int]) -> Episode:
    """Return `labyrinth.replay(actions)`."""
    return labyrinth.replay(actions)

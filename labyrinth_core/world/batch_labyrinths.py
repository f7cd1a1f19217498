"""Labyrinths by the thousand, in arrays: their rules, their states, and episodes replayed."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.world.batch_sampling import Structures
from labyrinth_core.world.labyrinth import UNREACHABLE, Look, Task
from labyrinth_core.world.state_tables import distances_from


@dataclass(frozen=True, eq=False)
class Labyrinths:
    """Labyrinths of one size, task and look, n of them, whose tiles have a cell each.

    States are numbered as in `dynamics.state_index`.
    """

    structures: Structures
    task: Task
    look: Look
    tiles: NDArray[np.int64]
    """The cells of start and goal, with a key then of key and door, shape (n, 2) or (n, 4)."""
    ice: NDArray[np.bool_]
    """Whether there is ice in each cell, shape (n, cells)."""

    def __len__(self) -> int:
        return len(self.tiles)

    def take(self, numbers: NDArray[np.int64]) -> Labyrinths:
        """Return some of the labyrinths."""
        up, right = (passages[numbers] for passages in (self.structures.up, self.structures.right))
        return replace(
            self,
            structures=replace(self.structures, up=up, right=right),
            tiles=self.tiles[numbers],
            ice=self.ice[numbers],
        )

    def keep_the_rules(self) -> bool:
        """Return whether each is what `Labyrinth` allows."""
        count, cells = self.ice.shape
        first = cells * np.arange(count)
        onward = self.structures.moves().reshape(-1, 4) + np.repeat(first, cells)[:, None]
        start, goal, *locked = (self.tiles + first[:, None]).T
        kept = distances_from(onward, goal, np.flatnonzero(self.ice))[start] != UNREACHABLE
        if locked:
            key, door = locked
            before_door = distances_from(onward, start, door) != UNREACHABLE
            kept &= before_door[key] & ~before_door[goal]
        return bool(kept.all())

    def transitions(self) -> NDArray[np.int32]:
        """Return the state that each action leads to, shape (n, states, 4).

        States that cannot be have no meaning, as in `dynamics.transition_table`.
        """
        moves = self.structures.moves()
        if self.task is not Task.KEY_AND_DOOR:
            return moves
        cells = self.ice.shape[1]
        key, door = (self.tiles[:, place, None, None] for place in (2, 3))
        stay = np.arange(cells, dtype=np.int32)[:, None]
        without_key = np.where(moves == door, stay, moves) + cells * (moves == key)
        with_key = cells + moves + cells * (moves == door)
        return np.concatenate([without_key, with_key, 2 * cells + moves], axis=1, dtype=np.int32)

    def terminal(self) -> NDArray[np.bool_]:
        """Return whether an episode ends in each state, shape (n, states)."""
        ends = self.ice.copy()
        np.put_along_axis(ends, self.tiles[:, 1:2], True, axis=1)
        return np.tile(ends, 3 if self.task is Task.KEY_AND_DOOR else 1)


def replay_many(
    labyrinths: Labyrinths,
    which: NDArray[np.int64],
    firsts: NDArray[np.int64],
    actions: NDArray[np.int64],
) -> tuple[NDArray[np.int64], NDArray[np.bool_]] | None:
    """Return the states of episodes, one after the other, and whether each is terminal.

    All episodes make a step at a time.

    Args:
        labyrinths: Labyrinths that keep the rules.
        which: The number of each episode's labyrinth.
        firsts: The place of the first state of each episode in the result, ascending from 0.
        actions: The action taken in each state, 0 to 3; any in the last state of an episode.

    Returns:
        The numbers of the states and whether an episode ends in them, shape (len(actions),) each;
        None if an episode goes on after its end.
    """
    transitions, terminal = labyrinths.transitions(), labyrinths.terminal()
    states_of_one = terminal.shape[1]
    offset = states_of_one * which
    onward = transitions.ravel()
    ends = np.append(firsts[1:], len(actions))
    longest_first = np.argsort(firsts - ends, kind="stable")
    lengths = (ends - firsts)[longest_first]
    place, offset = firsts[longest_first], offset[longest_first]
    now = labyrinths.tiles[which[longest_first], 0]
    states = np.empty(len(actions), np.int64)
    for step in range(lengths[0]):
        going = np.searchsorted(-lengths, -step)
        place, offset, now = place[:going], offset[:going], now[:going]
        states[place] = now
        now = onward.take(4 * (offset + now) + actions.take(place))
        place = place + 1
    over = terminal.ravel()[states_of_one * np.repeat(which, ends - firsts) + states]
    last = np.zeros(len(actions), np.bool_)
    last[ends - 1] = True
    return None if (over & ~last).any() else (states, over)

"""All episodes of a part replayed together, so that their states can be drawn together.

Nothing here is done row by row. What is not as datasets of ours are is left to `episodes`, which
takes rows one by one, and says what is wrong with them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.data.columns import NO_ACTION
from labyrinth_core.data.observations import ObservationSpec
from labyrinth_core.data.row_arrays import Columns
from labyrinth_core.data.transitions import Keep
from labyrinth_core.language.parse_many import parse_many
from labyrinth_core.language.text import labyrinth_id
from labyrinth_core.world.batch_labyrinths import Labyrinths, replay_many

PARSED_CELLS = 2**16
"""The cells of labyrinths that are parsed and replayed together."""
DRAWN_CELLS = 2**20
"""The cells of labyrinths, one for each picture, that are drawn together at most."""


class _Block(NamedTuple):
    """The states of consecutive episodes."""

    labyrinths: Labyrinths
    which: NDArray[np.int64]
    """The number of the labyrinth in each row, shape (rows,)."""
    states: NDArray[np.int64]
    """The number of the state in each row, shape (rows,)."""


@dataclass(frozen=True, eq=False)
class Replays:
    """The states of all episodes of a part, in order."""

    blocks: list[_Block]
    fields: dict[str, NDArray[Any]]
    """The fields of `Transitions` except the frames."""

    def fill(self, keep: Keep, spec: ObservationSpec, *, at_once: bool) -> dict[str, NDArray[Any]]:
        """Draw all states, and return the fields of `Transitions` except the frames.

        Args:
            keep: Gets the pictures in order, and no longer has them after it returns, unless it
                gets all of them.
            spec: How the states are observed.
            at_once: Whether to draw all pictures before `keep` gets them.
        """
        count = sum(len(block.states) for block in self.blocks)
        shape = count if at_once else spec.together, spec.image_size, spec.image_size, 3
        room, done = np.empty(shape, np.uint8), 0
        for labyrinths, which, states in self.blocks:
            together = min(spec.together, max(1, DRAWN_CELLS // labyrinths.ice.shape[1]))
            for first in range(0, len(states), together):
                rows = slice(first, first + together)
                place = done if at_once else 0
                pictures = room[place : place + len(states[rows])]
                spec.draw_many(pictures, labyrinths, which[rows], states[rows])
                done += len(pictures)
                if not at_once:
                    keep(pictures)
        if at_once:
            keep(room)
        return self.fields


def replays_of(columns: Columns) -> Replays | None:
    """Return the replayed episodes of columns, None if that is left to `episodes`."""
    actions, info, texts = columns.actions, columns.info, columns.texts
    last = actions == NO_ACTION
    ends = np.flatnonzero(last)
    if not len(ends) or ends[-1] != len(actions) - 1:
        return None
    firsts = np.concatenate([[0], ends[:-1] + 1])
    acting = np.flatnonzero(~last)
    regular = (
        np.array_equal(np.flatnonzero(columns.episode_starts), firsts)
        and (firsts < ends).all()
        and (info[acting] == info[acting + 1]).all()
        and ((actions[acting] >= 0) & (actions[acting] < 4)).all()
    )
    if not regular:
        return None
    # A text of a labyrinth has at least eight characters for each cell.
    together = max(1, PARSED_CELLS * 8 // (len(texts[0]) + 1))
    number = np.maximum.accumulate(info[firsts]) // together
    begins = np.flatnonzero(np.diff(number, prepend=-1))
    blocks, over = [], []
    for begin, end in zip(begins, np.append(begins[1:], len(firsts)), strict=True):
        rows = slice(firsts[begin], ends[end - 1] + 1)
        some, which = np.unique(info[firsts[begin:end]], return_inverse=True)
        labyrinths = parse_many([texts[place] for place in some.tolist()])
        if labyrinths is None:
            return None
        replayed = replay_many(labyrinths, which, firsts[begin:end] - rows.start, actions[rows])
        if replayed is None:
            return None
        states, terminal = replayed
        lengths = (ends - firsts)[begin:end] + 1
        blocks.append(_Block(labyrinths, np.repeat(which, lengths), states))
        over.append(terminal)
    ids = np.array([int(labyrinth_id(text), 16) for text in texts], np.int64)
    fields: dict[str, NDArray[Any]] = {
        "rows": acting,
        "actions": actions[acting],
        "rewards": columns.rewards[acting],
        "dones": np.concatenate(over)[acting + 1],
        "labyrinth_ids": ids[info[acting]],
    }
    return Replays(blocks, fields)

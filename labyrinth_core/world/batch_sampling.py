"""Random structures by the thousand, in arrays."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.world.batch_trees import BATCH_ALGORITHMS, Passages, walk_together
from labyrinth_core.world.grid import Action, horizontal_edges, vertical_edges
from labyrinth_core.world.labyrinth import Structure
from labyrinth_core.world.sampling import BLOCK, checked_open_walls, default_open_walls, twelfths_of


@dataclass(frozen=True, eq=False)
class Structures:
    """Structures of one size, n of them."""

    height: int
    width: int
    up: NDArray[np.bool_]
    """Whether each cell has a passage to the cell above, shape (n, cells)."""
    right: NDArray[np.bool_]
    """Whether each cell has a passage to the cell at the right, shape (n, cells)."""

    def __len__(self) -> int:
        return len(self.up)

    def __getitem__(self, place: int) -> Structure:
        up, right = (
            int.from_bytes(np.packbits(passages[place], bitorder="little").tobytes(), "little")
            for passages in (self.up, self.right)
        )
        return Structure(self.height, self.width, up, right)

    def without_walls(self) -> Structure:
        """Return the structure of this size that has all passages."""
        edges = vertical_edges(self.height, self.width), horizontal_edges(self.height, self.width)
        return Structure(self.height, self.width, *edges)

    def moves(self) -> NDArray[np.int32]:
        """Return `Structure.moves` of each: where the actions lead, shape (n, cells, 4)."""
        moves = np.empty((*self.up.shape, 4), np.int32)
        moves[:] = np.arange(self.height * self.width)[:, None]
        for passages, step, onward, back in (
            (self.up, self.width, Action.UP, Action.DOWN),
            (self.right, 1, Action.RIGHT, Action.LEFT),
        ):
            moves[:, :, onward] += step * passages
            moves[:, step:, back] -= step * passages[:, :-step]
        return moves


def sample_many(
    height: int,
    width: int,
    count: int,
    rng: np.random.Generator,
    *,
    algorithm: str = "wilson",
    open_walls: float | None = None,
) -> Structures:
    """Return random connected structures; a structure may come again.

    The arguments are those of `sampling.sample_structures`, and so are the probabilities. The
    structures are not those that it yields from the same generator.

    Raises:
        ValueError: The algorithm is unknown, or `open_walls` is no probability.
    """
    open_walls = checked_open_walls(height, width, algorithm, open_walls)
    trees = BATCH_ALGORITHMS[algorithm](height, width, count, rng)
    coins = rng.random((count, 2, height * width))
    return _opened(height, width, trees, coins < open_walls)


def _opened(height: int, width: int, trees: Passages, heads: NDArray[np.bool_]) -> Structures:
    """Return the structures that trees become when walls are opened, as (n, 2, cells) coins say."""
    up, right = (passages | heads[:, axis] for axis, passages in enumerate(trees))
    up[:, -width:] = False
    right[:, width - 1 :: width] = False
    return Structures(height, width, up, right)


class Drawn(NamedTuple):
    """What `sample_each` drew."""

    numbers: NDArray[np.int64]
    """The numbers of the generators that gave a structure."""
    structures: Structures
    """Their structures."""
    before: list[Mapping[str, Any]]
    """The states that they were in before."""


def sample_each(height: int, width: int, generators: Sequence[np.random.Generator]) -> Drawn:
    """Return the first structure that `sample_structures` yields from each of some generators.

    The few whose walks are long are left out, and so are generators other than numpy's default
    ones; these stay as they were.

    Args:
        height: Rows.
        width: Columns; of no more than `WORD` cells.
        generators: As many as structures.
    """
    cells = height * width
    limit = cells * cells.bit_length() * 3 // 2  # Of any size, 96 walks in 100 take no more steps.
    fit, before, words = [], [], []
    for number, generator in enumerate(generators):
        state = generator.bit_generator.state
        if state["bit_generator"] == "PCG64" and not state["has_uint32"]:
            fit.append(number)
            before.append(state)
            # In a fraction of their time, what generator.bytes(BLOCK) and random(2 * cells) read.
            words.append(generator.bit_generator.random_raw(BLOCK // 8 + 2 * cells))
    raw = np.array(words, np.uint64).reshape(-1, BLOCK // 8 + 2 * cells)
    steps, complete = _twelfths(raw[:, : limit // 8 + 4], limit)
    trees, growing = walk_together(
        height, width, len(fit), lambda step, numbers: steps[step].take(numbers), limit
    )
    complete[growing] = False
    for row in np.flatnonzero(~complete).tolist():
        generators[fit[row]].bit_generator.state = before[row]
    up, right = (passages[complete] for passages in trees)
    coins = (raw[complete, BLOCK // 8 :] >> 11).reshape(-1, 2, cells) / 2**53
    structures = _opened(height, width, (up, right), coins < default_open_walls(height, width))
    rows = np.flatnonzero(complete)
    return Drawn(np.array(fit, np.int64)[rows], structures, [before[row] for row in rows.tolist()])


def _twelfths(words: NDArray[np.uint64], limit: int) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:
    """Return the first integers from 0 to 11 that rows of words make, and which make enough.

    Args:
        words: Random words, shape (n, words).
        limit: The number of integers wanted of each row.

    Returns:
        The integers, shape (limit, n), and whether each row made so many, shape (n,).
    """
    draws = [twelfths_of(row.tobytes())[:limit] for row in words.astype("<u8")]
    padded = b"".join(each.ljust(limit, b"\0") for each in draws)
    steps = np.frombuffer(padded, np.uint8).reshape(-1, limit).T
    return steps.copy(), np.array([len(each) == limit for each in draws], np.bool_)

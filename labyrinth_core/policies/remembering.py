"""Policies that remember pictures under partial observability.

A remembering policy is shown one picture of all that was visible in the episode so far, with the
agent where it is now. What has not been seen yet is shown as floor without walls: the free-space
assumption, as in `evaluation.replanner`. The memory is made from pictures alone. It is given the
number of rows and columns, the thickness of walls, that walls and hidden cells are black and floors
white, and that each cell has a way out. It is not given what start, goal and agent look like, what
actions do, or where the agent has been.
"""

from __future__ import annotations

from hashlib import blake2b
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.evaluation.answers import Policy, PolicyError, fitted
from labyrinth_core.pictures.bands import Sums, bands_of
from labyrinth_core.pictures.png import DEFAULT_IMAGE_SIZE
from labyrinth_core.pictures.renderer import AGENT_INSET, DEFAULT_STYLE
from labyrinth_core.world.labyrinth import Task

Pictures = NDArray[np.uint8]

CELLS, WALLS = slice(2, -2, 2), slice(3, -3, 2)
"""Which bands along an axis are cells, and which are the walls between them."""

HALF = 127
"""The brightest channel of a pixel that a wall covers more than half of, at most."""


class PictureMemory:
    """What was seen in B episodes, and the pictures of it.

    A picture consists of bands of rows times bands of columns (`pictures.bands`): cells, and the
    walls between them. The colour of each cell and each open passage is read from the pixel that it
    covers most. Black in a picture is a wall or hidden, and changes nothing in memory. Everything
    else is kept as it was seen last: the agent sees the cell that it has left from the next one, so
    that this cell is remembered without the agent. All pixels follow from the bands, except those
    of the agent's cell, which are copied from the picture.
    """

    def __init__(
        self,
        height: int,
        width: int,
        image_size: int = DEFAULT_IMAGE_SIZE,
    ) -> None:
        """Begin with no episode.

        Args:
            height: The number of rows of the labyrinths.
            width: The number of columns.
            image_size: Pixels on each side of the pictures.

        Raises:
            ValueError: The labyrinths have walls that are thinner than a pixel.
        """
        self.image_size = image_size
        self._bands = bands = bands_of(height, width, None, image_size)
        down, across = bands.rows.bands[bands.row], bands.columns.bands
        if _is_coarse(down) or _is_coarse(across):
            raise ValueError(
                f"pictures of {image_size} pixels are too small to remember {height}x{width} "
                "labyrinths: a wall has to be as thick as a pixel"
            )
        # Of each band the line of pixels that it covers most; of each cell the lines that it is in.
        self._rows, self._columns = down.argmax(axis=0), across.argmax(axis=0)
        self._in_cells = tuple(each[:, CELLS].T > 0 for each in (down, across))
        squares = bands.rows.squares[AGENT_INSET][:, bands.row], bands.columns.squares[AGENT_INSET]
        self._inside = tuple(each.argmax(axis=1) for each in squares)
        self.reset(0)

    def reset(self, count: int) -> None:
        """Begin `count` episodes, in which nothing has been seen."""
        self.seen = np.zeros((count, len(self._rows), len(self._columns), 3), np.uint8)
        """The colours of the bands that were seen, (B, 2 height + 3, 2 width + 3, 3), from the top;
        black where nothing was seen, and for walls."""
        for edge in (0, -1):  # A margin around the labyrinth is always shown.
            self.seen[:, edge] = self.seen[:, :, edge] = DEFAULT_STYLE.floor

    def add(self, pictures: Pictures) -> Pictures:
        """Remember the next picture of each episode; return what has been seen until now.

        Args:
            pictures: Shape (B, image_size, image_size, 3).

        Returns:
            Of the same shape.
        """
        read = pictures[:, self._rows[:, None], self._columns]
        cells = read[:, CELLS, CELLS]
        shown = (cells != DEFAULT_STYLE.hidden).any(axis=3, keepdims=True)
        np.copyto(self.seen[:, CELLS, CELLS], cells, where=shown)
        for place in ((slice(None), WALLS, CELLS), (slice(None), CELLS, WALLS)):
            self.seen[place][read[place].max(axis=3) > HALF] = DEFAULT_STYLE.floor
        drawn = self._draw(_with_floor(self.seen))
        rows, columns = self._agents(pictures, cells)
        mine = self._in_cells[0][rows][:, :, None] & self._in_cells[1][columns][:, None]
        drawn[mine] = pictures[mine]
        return drawn

    def _draw(self, shown: Pictures) -> Pictures:
        bands = self._bands
        planes = shown.transpose(0, 3, 1, 2).astype(bands.rows.bands.dtype)
        sums = bands.rows.bands @ planes @ bands.columns.bands.T + bands.unit // 2
        return bands.rounded(sums.transpose(0, 2, 3, 1)).take(bands.row, axis=1)

    def _agents(self, pictures: Pictures, cells: Pictures) -> tuple[NDArray[np.intp], ...]:
        """Return row, from the top, and column of the only cell that is not of one colour."""
        middles = pictures[:, self._inside[0][::-1, None], self._inside[1]].astype(np.int16)
        differs = np.abs(middles - cells).sum(axis=3)
        places = differs.reshape(len(pictures), -1).argmax(axis=1)
        return np.divmod(places, differs.shape[2])


class Remembering:
    """A policy that is shown what has been seen so far, in one picture, as `evaluate` takes it."""

    observation = "image"

    def __init__(self, policy: Policy, memory: PictureMemory) -> None:
        """Begin with no episode.

        Args:
            policy: What answers to such pictures; a function that remembers nothing.
            memory: What makes them.
        """
        self.policy, self.memory = policy, memory
        self.image_size = memory.image_size

    def for_labyrinths(self, height: int, width: int, task: Task) -> Remembering:
        """Return the policy with a memory for labyrinths of another size.

        Raises:
            PolicyError: The policy cannot be shown the pictures of the memory.
            ValueError: The labyrinths have walls that are thinner than a pixel.
        """
        policy, spec = fitted(
            self.policy, height, width, task, observation="image", image_size=self.image_size
        )
        if spec.resize != "area":
            raise PolicyError(f"the memory cannot show pictures of resize={spec.resize}")
        return Remembering(policy, PictureMemory(height, width, self.image_size))

    def reset(self, count: int) -> None:
        """Begin `count` episodes, in which nothing has been seen."""
        self.memory.reset(count)
        self._answers: dict[bytes, NDArray[Any]] = {}

    def act(self, pictures: Pictures) -> NDArray[Any]:
        """Return the policy's answers after the next pictures of B episodes, B of them."""
        shown = self.memory.add(pictures)
        keys = [blake2b(each.tobytes(), digest_size=16).digest() for each in shown]
        # The pictures of episodes that are over come again.
        new = {key: place for place, key in enumerate(keys) if key not in self._answers}
        if new:
            answers = np.asarray(self.policy(shown[list(new.values())]))
            self._answers |= dict(zip(new, answers, strict=True))
        return np.stack([self._answers[key] for key in keys])

    def remembered(self) -> Pictures:
        """Return the memory, a row for each episode."""
        return self.memory.seen


def _with_floor(seen: Pictures) -> Pictures:
    """Return what was seen, with floor in place of cells and passages that may be open.

    Start and goal are shown even if unseen. But every cell has a way out, so
    a cell that was seen has an open passage, and anything else that is black around it is a wall.
    """
    shown: Pictures = seen.copy()
    cells, down, across = (
        shown[:, CELLS, CELLS],
        shown[:, WALLS, CELLS],
        shown[:, CELLS, WALLS],
    )
    below, beside, coloured = (each.any(axis=3) for each in (down, across, cells))
    open_ = np.zeros_like(coloured)
    open_[:, :-1] |= below
    open_[:, 1:] |= below
    open_[:, :, :-1] |= beside
    open_[:, :, 1:] |= beside
    known = coloured & open_
    cells[~coloured] = DEFAULT_STYLE.floor
    down[~(known[:, :-1] | known[:, 1:])] = DEFAULT_STYLE.floor
    across[~(known[:, :, :-1] | known[:, :, 1:])] = DEFAULT_STYLE.floor
    return shown


def _is_coarse(weights: Sums) -> bool:
    """Return whether a line is in two cells, or no line mostly in some band between the margins.

    Args:
        weights: The weight of each band in each line of pixels.
    """
    several = (weights[:, CELLS] > 0).sum(axis=1) > 1
    most = weights[:, 1:-1].max(axis=0)
    return bool(several.any() or (2 * most <= weights[0].sum()).any())

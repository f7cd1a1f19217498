"""Cache the pictures of many labyrinths, so that a step draws only what changes.

For each labyrinth the gallery keeps the picture without the agent, and the patches that show the
agent in each cell. A step copies the picture and pastes a patch, or exchanges two patches in place.
Under partial observability more than a patch changes, so the gallery keeps the picture with the
agent, and redraws it when the agent moves.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.pictures.backdrops import (
    Backdrops,
    Corners,
    Mask,
    Numbers,
    Pictures,
    Scenes,
    backdrops_of,
    cut,
    paste,
)
from labyrinth_core.pictures.bands import bands_of
from labyrinth_core.pictures.scenes import draw_states
from labyrinth_core.pictures.style import Style, style_for
from labyrinth_core.world import Look, Task

LOOKS = tuple(Look)


class Stack(Protocol):
    """Labyrinths of one size and task, and the state of the agent in each."""

    initial_vectors: NDArray[np.int32]
    """The `vector.initial_vector` of each labyrinth."""
    looks: NDArray[np.intp]
    """The look of each labyrinth, as an index in `Look`."""

    def states(self) -> NDArray[np.int64]:
        """Return the index of each agent's state within its labyrinth, shape (count,)."""

    def visible(self) -> NDArray[np.bool_]:
        """Return `Structure.visible_from` for each agent, shape (count, height, width)."""


class Gallery:
    """The pictures of a number of labyrinths of one size and task.

    It caches the first ones, as many as its memory holds; the others are redrawn every time.
    """

    def __init__(
        self, count: int, shape: tuple[int, int, Task], image_size: int, memory: int, *, copy: bool
    ) -> None:
        """Make room for pictures.

        Args:
            count: The number of labyrinths.
            shape: Their height, width and task.
            image_size: Pixels on each side of a picture.
            memory: The most bytes to keep.
            copy: Whether `pictures` returns a new array each time, not always the same one.

        Raises:
            ValueError: The labyrinths are too large for every wall to have a pixel.
        """
        self._count, self._size, self._copy, self._shape = count, image_size, copy, shape
        height, width, task = shape
        self._cells = height * width
        self._hides = task.rules.hides
        self._reach = reach = bands_of(height, width, None, image_size).reach
        patches = 0 if self._hides else self._cells
        self._kept = kept = min(count, memory // (3 * (image_size**2 + patches * reach**2)))
        self._shown = np.empty((kept if copy else count, image_size, image_size, 3), np.uint8)
        self._patches = np.empty((kept, patches, reach, reach, 3), np.uint8)
        self._corners = np.zeros((len(LOOKS), 2, self._cells), np.intp)
        self._drawn = np.full(kept, -1, np.int64)
        """What each cached picture shows: the index of the state if cells are hidden, else 0, or 1
        with the key, or 2 with the door open; -1 for no picture."""
        self._covered: tuple[Corners, Pictures] | None = None
        """The pixels under the patches now shown, if patches are exchanged in place."""

    def forget(self, places: Numbers) -> None:
        """Forget the labyrinths in some places, which have been replaced."""
        self._drawn[places[places < self._kept]] = -1

    def pictures(self, stack: Stack) -> Pictures:
        """Return the pictures of all labyrinths, shape (count, image_size, image_size, 3)."""
        states, kept = stack.states(), np.arange(self._kept)
        if self._covered is not None:
            paste(self._shown, kept, *self._covered)
        phases, agents = np.divmod(states[: self._kept], self._cells)
        self._renew(stack, states[: self._kept] if self._hides else phases)
        shown = self._shown
        if self._copy:
            shown = np.empty((self._count, *shown.shape[1:]), np.uint8)
            shown[: self._kept] = self._shown
        if not self._hides:
            tops, lefts = self._corners[stack.looks[: self._kept], :, agents].T
            if not self._copy:
                self._covered = (tops, lefts), cut(shown, kept, (tops, lefts), self._reach)
            paste(shown, kept, (tops, lefts), self._patches[kept, agents])
        if self._kept < self._count:
            shown[self._kept :] = self._draw(stack, np.arange(self._kept, self._count))
        if not self._copy:
            shown = shown.view()
            shown.setflags(write=False)
        return shown

    def _alike(self, stack: Stack, places: Numbers) -> Iterator[tuple[int, Style, Numbers]]:
        """Yield each look of the labyrinths in some places, its style, and its places."""
        looks = stack.looks[places]
        for look in np.unique(looks).tolist():
            yield look, style_for(LOOKS[look], *self._shape[:2]), places[looks == look]

    def _draw(self, stack: Stack, places: Numbers) -> Pictures:
        """Draw the pictures of the labyrinths in some places, without the cache."""
        pictures = np.empty((len(places), *self._shown.shape[1:]), np.uint8)
        for _, style, alike in self._alike(stack, places):
            pictures[np.isin(places, alike)] = draw_states(
                self._shape,
                stack.initial_vectors,
                alike,
                stack.states()[alike],
                self._size,
                style,
                visible=lambda which, _: stack.visible()[which],
            )
        return pictures

    def _renew(self, stack: Stack, needed: Numbers) -> None:
        """Draw the pictures that are needed but not cached; see `_drawn`."""
        stale = np.flatnonzero(self._drawn != needed)
        if not len(stale):
            return
        if self._hides:
            self._shown[stale] = self._draw(stack, stale)
        else:
            self._draw_scenes(stack, stale, needed)
        self._drawn[stale] = needed[stale]

    def _draw_scenes(self, stack: Stack, stale: Numbers, needed: Numbers) -> None:
        for look, style, alike in self._alike(stack, stale):
            phases = needed[alike]
            scenes = Scenes(*self._shape, stack.initial_vectors[alike], phases >= 1, phases == 2)
            for first, backdrops in backdrops_of(scenes, self._size, style):
                places = alike[first : first + len(backdrops)]
                self._shown[places] = backdrops.bare()
                self._patches[places] = self._everywhere(backdrops, needed[places] == 1)
            self._corners[look] = backdrops.corners(np.arange(self._cells))

    def _everywhere(self, backdrops: Backdrops, with_key: Mask) -> Pictures:
        """Return the patches of an agent in each cell, shape (N, cells, reach, reach, 3)."""
        scenes = np.repeat(np.arange(len(backdrops)), self._cells)
        agents = np.tile(np.arange(self._cells), len(backdrops))
        patches = backdrops.patches(scenes, agents, with_key[scenes])
        return patches.reshape(-1, *self._patches.shape[1:])

"""Draw pictures of many states at once, at any size, with the same pixels as `renderer`.

Parts that states share are drawn once, and labyrinths of one size are drawn together. `renderer`
makes the strips of PNG files, and takes half the time for pictures of 600 x 600. Smaller pictures,
which loading, environments and evaluation use, are drawn faster here. `KeptScenes` and `Gallery`
keep what they drew.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.checks import whole
from labyrinth_core.pictures.backdrops import (
    Backdrops,
    Corners,
    Mask,
    Numbers,
    Pictures,
    Scenes,
    backdrops_of,
    bands_of,
    cut,
    memory_of_scene,
    paste,
)
from labyrinth_core.pictures.png import PICTURE_SIZE
from labyrinth_core.pictures.renderer import Painter
from labyrinth_core.pictures.style import Style, style_for
from labyrinth_core.pictures.vector import (
    grid_indices,
    initial_vector,
    initial_vectors,
    seen_by,
)
from labyrinth_core.world import Labyrinth, Labyrinths, Look, State, Task

LOOKS = tuple(Look)

DRAWN_BYTES, DRAWN_CELLS = 2**23, 2**20
"""The most bytes of pictures, and cells of their labyrinths, to draw together."""


def draw(
    views: Sequence[tuple[Labyrinth, State]],
    image_size: int,
    *,
    wall_pixels: int | None = None,
    resize: str = "area",
) -> Pictures:
    """Return pictures of N states of any labyrinths, shape (N, image_size, image_size, 3).

    Args:
        views: The states, each with its labyrinth.
        image_size: Pixels on each side of a picture.
        wall_pixels: The thickness of walls; None for the thickness of each labyrinth's look.
        resize: One of `resize.RESIZES`.

    Raises:
        ValueError: A labyrinth is too large for every wall to have a pixel, or `image_size` is not
            an integer from 1 to `PICTURE_SIZE`.
    """
    image_size = whole("image_size", image_size, 1, PICTURE_SIZE)
    # Labyrinths are compared by identity: comparing values takes as long as drawing one twice.
    kinds: dict[int, tuple[Any, ...]] = {}
    groups: dict[tuple[Any, ...], list[int]] = {}
    for index, (labyrinth, _) in enumerate(views):
        if id(labyrinth) not in kinds:
            structure = labyrinth.structure
            kind = structure.height, structure.width, labyrinth.task, labyrinth.look
            kinds[id(labyrinth)] = kind
        groups.setdefault(kinds[id(labyrinth)], []).append(index)
    pictures = np.empty((len(views), image_size, image_size, 3), np.uint8)
    for (height, width, task, look), indices in groups.items():
        style = style_for(look, height, width, wall_pixels)
        some = [views[index] for index in indices]
        if image_size == PICTURE_SIZE:
            painters = {id(labyrinth): Painter(labyrinth, style) for labyrinth, _ in some}
            for index, (labyrinth, state) in zip(indices, some, strict=True):
                pictures[index] = painters[id(labyrinth)].array(state)
            continue
        drawn = _draw_alike((height, width, task), some, image_size, style, resize)
        if len(groups) == 1:
            return drawn
        pictures[indices] = drawn
    return pictures


def _draw_alike(
    shape: tuple[int, int, Task],
    views: Sequence[tuple[Labyrinth, State]],
    image_size: int,
    style: Style,
    resize: str,
) -> Pictures:
    """Return the pictures of states of labyrinths of one size, task and style."""
    numbers: dict[int, int] = {}
    distinct: list[Labyrinth] = []
    which = []
    for labyrinth, _ in views:
        number = numbers.setdefault(id(labyrinth), len(distinct))
        if number == len(distinct):
            distinct.append(labyrinth)
        which.append(number)

    def visible(which: Numbers, agents: Numbers) -> Mask:
        seen = np.zeros((len(which), shape[0] * shape[1]), np.bool_)
        for row, number, agent in zip(seen, which.tolist(), agents.tolist(), strict=True):
            row[list(distinct[number].structure.visible_from(agent))] = True
        return seen.reshape(-1, *shape[:2])

    return draw_states(
        shape,
        np.stack([initial_vector(labyrinth) for labyrinth in distinct]),
        np.array(which),
        np.array([labyrinth.state_index(state) for labyrinth, state in views]),
        image_size,
        style,
        resize,
        visible=visible,
    )


def draw_many(
    labyrinths: Labyrinths,
    which: Numbers,
    states: Numbers,
    image_size: int,
    *,
    wall_pixels: int | None = None,
    resize: str = "area",
    out: Pictures | None = None,
) -> Pictures:
    """Return what `draw` returns, given labyrinths and states as arrays.

    Args:
        labyrinths: The labyrinths.
        which: The index of the labyrinth in each picture, shape (N,).
        states: The index of the state in each, as in `Labyrinth.state_index`, shape (N,).
        image_size: Pixels on each side of a picture.
        wall_pixels: The thickness of walls; None for the thickness of the labyrinths' look.
        resize: One of `resize.RESIZES`.
        out: Where the pictures go, shape (N, image_size, image_size, 3); None for a new array.

    Raises:
        ValueError: The labyrinths are too large for every wall to have a pixel, or `image_size` is
            not an integer from 1 to `PICTURE_SIZE`.
    """
    height, width = labyrinths.structures.height, labyrinths.structures.width
    image_size = whole("image_size", image_size, 1, PICTURE_SIZE)

    def visible(which: Numbers, agents: Numbers) -> Mask:
        return seen_by(labyrinths.take(which), agents)

    return draw_states(
        (height, width, labyrinths.task),
        initial_vectors(labyrinths.structures, labyrinths.tiles, labyrinths.ground),
        which,
        states,
        image_size,
        style_for(labyrinths.look, height, width, wall_pixels),
        resize,
        visible=visible,
        out=out,
    )


def draw_states(
    shape: tuple[int, int, Task],
    vectors: NDArray[np.int32],
    which: Numbers,
    states: Numbers,
    image_size: int,
    style: Style,
    resize: str = "area",
    *,
    visible: Callable[[Numbers, Numbers], Mask],
    out: Pictures | None = None,
) -> Pictures:
    """Return the pictures of states of labyrinths of one size, task and style.

    Args:
        shape: The rows and columns of cells, and the task.
        vectors: The `initial_vector` of each labyrinth, shape (L, length).
        which: The index of the labyrinth in each picture, shape (N,).
        states: The index of the state in each, as in `Labyrinth.state_index`, shape (N,).
        image_size: Pixels on each side of a picture.
        style: The colours and the thickness of walls.
        resize: One of `resize.RESIZES`.
        visible: Returns which cells are visible, shape (n, height, width), given n items of `which`
            and the agents' cells; called only under partial observability.
        out: Where the pictures go, shape (N, image_size, image_size, 3); None for a new array.
    """
    height, width, task = shape
    cells = height * width
    grid_index, hides = grid_indices(height, width), task.rules.hides
    pictures = np.empty((len(states), image_size, image_size, 3), np.uint8) if out is None else out
    together = max(1, min(DRAWN_BYTES // (3 * image_size**2), DRAWN_CELLS // cells))
    for start in range(0, len(states), together):
        own = which[start : start + together]
        phase, agents = np.divmod(states[start : start + together], cells)
        key_gone, door_open = phase > 0, phase > 1
        if task.rules.phases > 1:  # An agent on the key's cell hides the key.
            key_gone = key_gone | (grid_index[agents] == vectors[own, 3])
        kinds = own * (cells + 4) + (agents if hides else 2 * key_gone + door_open)
        _, first, scene = np.unique(kinds, return_index=True, return_inverse=True)
        seen = visible(own[first], agents[first]) if hides else None
        scenes = Scenes(*shape, vectors[own[first]], key_gone[first], door_open[first], seen)
        _fill(
            pictures[start : start + together],
            backdrops_of(scenes, image_size, style, resize),
            scene,
            agents,
            phase == 1,
        )
    return pictures


class KeptScenes:
    """Draws states as `draw_many` does, and keeps the scenes of all labyrinths.

    The scene of a large labyrinth takes much longer than the agent in it: at 100x100 20 ms. Under
    partial observability each state has a scene of its own, so they are not kept.
    """

    def __init__(
        self,
        labyrinths: Labyrinths,
        image_size: int,
        *,
        wall_pixels: int | None = None,
        resize: str = "area",
    ) -> None:
        """Draw the scenes; the arguments are those of `draw_many`."""
        structures = labyrinths.structures
        shape = structures.height, structures.width
        self._size, self._cells = image_size, structures.height * structures.width
        self._phases = labyrinths.task.rules.phases
        self._tiles = labyrinths.tiles
        which, phase = np.divmod(np.arange(len(labyrinths) * self._phases), self._phases)
        vectors = initial_vectors(structures, labyrinths.tiles, labyrinths.ground)
        scenes = Scenes(*shape, labyrinths.task, vectors[which], phase > 0, phase > 1)
        style = style_for(labyrinths.look, *shape, wall_pixels)
        parts = backdrops_of(scenes, image_size, style, resize)
        self._backdrops = Backdrops.joined(parts, len(which))

    @staticmethod
    def memory_of(
        labyrinths: Labyrinths,
        image_size: int,
        *,
        wall_pixels: int | None = None,
        resize: str = "area",
    ) -> int:
        """Return the bytes that the scenes take; the arguments are those of `draw_many`."""
        height, width = labyrinths.structures.height, labyrinths.structures.width
        thickness = style_for(labyrinths.look, height, width, wall_pixels).wall_pixels
        phases = labyrinths.task.rules.phases
        of_one = memory_of_scene(height, width, thickness, image_size, resize, phases)
        return len(labyrinths) * phases * of_one

    def draw(self, which: Numbers, states: Numbers) -> Pictures:
        """Return the pictures of N states; the arguments are those of `draw_many`."""
        phase, agents = np.divmod(states, self._cells)
        gone = phase
        if self._phases > 1:  # An agent on the key's cell hides the key.
            gone = np.maximum(phase, agents == self._tiles[which, 2])
        pictures = np.empty((len(states), self._size, self._size, 3), np.uint8)
        self._backdrops.draw(pictures, which * self._phases + gone, agents, phase == 1)
        return pictures


def _fill(
    pictures: Pictures,
    backdrops: Iterable[tuple[int, Backdrops]],
    scene: Numbers,
    agents: Numbers,
    with_key: Mask,
) -> None:
    """Fill pictures with the scene and the agent that each shows."""
    order = scene.argsort(kind="stable")
    ascending = scene[order]
    for first, some in backdrops:
        if not first and len(some) > ascending[-1]:  # All scenes are here: no order is needed.
            some.draw(pictures, scene, agents, with_key)
            return
        part = slice(*np.searchsorted(ascending, [first, first + len(some)]))
        indices = order[part]
        if not len(indices):
            continue
        in_order = (np.diff(indices) == 1).all()
        drawn = (
            pictures[indices[0] :][: len(indices)]
            if in_order
            else np.empty((len(indices), *pictures.shape[1:]), np.uint8)
        )
        some.draw(drawn, ascending[part] - first, agents[indices], with_key[indices])
        if not in_order:
            pictures[indices] = drawn


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

    For each labyrinth it keeps the picture without the agent, and the patches that show the agent
    in each cell. A step copies the picture and pastes a patch, or exchanges two patches in place.
    Under partial observability more than a patch changes, so it keeps the picture with the agent,
    and redraws it when the agent moves. It caches the first labyrinths, as many as its memory
    holds; the others are redrawn every time.
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

    def forget(self, slots: Numbers) -> None:
        """Forget the labyrinths in some slots, which have been replaced."""
        self._drawn[slots[slots < self._kept]] = -1

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

    def _alike(self, stack: Stack, slots: Numbers) -> Iterator[tuple[int, Style, Numbers]]:
        """Yield each look of the labyrinths in some slots, its style, and its slots."""
        looks = stack.looks[slots]
        for look in np.unique(looks).tolist():
            yield look, style_for(LOOKS[look], *self._shape[:2]), slots[looks == look]

    def _draw(self, stack: Stack, slots: Numbers) -> Pictures:
        """Draw the pictures of the labyrinths in some slots, without the cache."""
        pictures = np.empty((len(slots), *self._shown.shape[1:]), np.uint8)
        for _, style, alike in self._alike(stack, slots):
            pictures[np.isin(slots, alike)] = draw_states(
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
            for look, style, alike in self._alike(stack, stale):
                phases = needed[alike]
                scenes = Scenes(
                    *self._shape, stack.initial_vectors[alike], phases >= 1, phases == 2
                )
                for first, backdrops in backdrops_of(scenes, self._size, style):
                    slots = alike[first : first + len(backdrops)]
                    self._shown[slots] = backdrops.bare()
                    # The agent in each cell of each labyrinth.
                    shown = np.repeat(np.arange(len(backdrops)), self._cells)
                    agents = np.tile(np.arange(self._cells), len(backdrops))
                    with_key = np.repeat(needed[slots] == 1, self._cells)
                    patches = backdrops.patches(shown, agents, with_key)
                    self._patches[slots] = patches.reshape(-1, *self._patches.shape[1:])
                self._corners[look] = backdrops.corners(np.arange(self._cells))
        self._drawn[stale] = needed[stale]

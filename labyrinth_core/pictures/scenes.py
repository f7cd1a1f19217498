"""Draw pictures of many states at once, at any size, with the same pixels as `renderer`.

Parts that states share are drawn once, and labyrinths of one size are drawn together. `renderer`
makes the strips of PNG files, and takes half the time for pictures of 600 x 600. Smaller pictures,
which loading, environments and evaluation use, are drawn faster here.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.checks import whole
from labyrinth_core.pictures.backdrops import (
    Backdrops,
    Mask,
    Numbers,
    Pictures,
    Scenes,
    backdrops_of,
    memory_of_scene,
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
from labyrinth_core.world import Labyrinth, Labyrinths, State, Task

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
    for place, (labyrinth, _) in enumerate(views):
        if id(labyrinth) not in kinds:
            structure = labyrinth.structure
            kind = structure.height, structure.width, labyrinth.task, labyrinth.look
            kinds[id(labyrinth)] = kind
        groups.setdefault(kinds[id(labyrinth)], []).append(place)
    pictures = np.empty((len(views), image_size, image_size, 3), np.uint8)
    for (height, width, task, look), places in groups.items():
        style = style_for(look, height, width, wall_pixels)
        some = [views[place] for place in places]
        if image_size == PICTURE_SIZE:
            painters = {id(labyrinth): Painter(labyrinth, style) for labyrinth, _ in some}
            for place, (labyrinth, state) in zip(places, some, strict=True):
                pictures[place] = painters[id(labyrinth)].array(state)
            continue
        drawn = _draw_alike((height, width, task), some, image_size, style, resize)
        if len(groups) == 1:
            return drawn
        pictures[places] = drawn
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
    places, hides = grid_indices(height, width), task.rules.hides
    pictures = np.empty((len(states), image_size, image_size, 3), np.uint8) if out is None else out
    together = max(1, min(DRAWN_BYTES // (3 * image_size**2), DRAWN_CELLS // cells))
    for start in range(0, len(states), together):
        own = which[start : start + together]
        phase, agents = np.divmod(states[start : start + together], cells)
        key_gone, door_open = phase > 0, phase > 1
        if task.rules.phases > 1:  # An agent on the key's cell hides the key.
            key_gone = key_gone | (places[agents] == vectors[own, 3])
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
        places = order[part]
        if not len(places):
            continue
        in_order = (np.diff(places) == 1).all()
        drawn = (
            pictures[places[0] :][: len(places)]
            if in_order
            else np.empty((len(places), *pictures.shape[1:]), np.uint8)
        )
        some.draw(drawn, ascending[part] - first, agents[places], with_key[places])
        if not in_order:
            pictures[places] = drawn

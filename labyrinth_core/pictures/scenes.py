"""Pictures of many states at once, the very pixels of `renderer` at any size.

What states have in common is drawn once, and what labyrinths of one size have in common together.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import numpy as np

from labyrinth_core.pictures.backdrops import Scene, backdrops_of
from labyrinth_core.pictures.png import PICTURE_SIZE
from labyrinth_core.pictures.renderer import Painter, Style, style_of
from labyrinth_core.pictures.windows import Pictures
from labyrinth_core.world.dynamics import State
from labyrinth_core.world.labyrinth import Labyrinth, Task


def draw(
    views: Sequence[tuple[Labyrinth, State]],
    image_size: int,
    *,
    wall_pixels: int | None = None,
    resize: str = "area",
) -> Pictures:
    """Return the pictures of some states of some labyrinths, shape (N, image_size, image_size, 3).

    Args:
        views: Each state with its labyrinth, N of them.
        image_size: Pixels on each side of a picture.
        wall_pixels: The thickness of walls, if it is not that of the labyrinths' looks.
        resize: One of `resize.RESIZES`.

    Raises:
        ValueError: A labyrinth is too large for every wall to have a pixel.
    """
    distinct = {id(labyrinth): labyrinth for labyrinth, _ in views}
    styles = {each: style_of(labyrinth, wall_pixels) for each, labyrinth in distinct.items()}
    pictures = np.empty((len(views), image_size, image_size, 3), np.uint8)
    if image_size == PICTURE_SIZE:  # The strips of the renderer are the pixels.
        for place, (each, state) in enumerate(views):
            pictures[place] = _painter(each, styles[id(each)]).array(state)
        return pictures
    kinds = {each: _kind(labyrinth) for each, labyrinth in distinct.items()}
    groups = {kind: styles[each] for each, kind in kinds.items()}
    if len(groups) == 1:
        (style,) = groups.values()
        return _draw_alike(views, image_size, style, resize)
    for kind, style in groups.items():
        places = [place for place, (each, _) in enumerate(views) if kinds[id(each)] == kind]
        some = [views[place] for place in places]
        pictures[places] = _draw_alike(some, image_size, style, resize)
    return pictures


_painter = lru_cache(maxsize=1)(Painter)
"""The painter of a labyrinth; cached, as consecutive states may be of one labyrinth."""


def _draw_alike(
    views: Sequence[tuple[Labyrinth, State]], image_size: int, style: Style, resize: str
) -> Pictures:
    """Return the pictures of states of labyrinths of one size, task and style."""
    # Labyrinths are told apart by identity: to compare them takes as long as to draw one twice.
    found: dict[tuple[Any, ...], list[int]] = {}
    for place, (labyrinth, (agent, has_key, door_open)) in enumerate(views):
        seen_from = agent if labyrinth.task is Task.PARTIAL_OBSERVABILITY else None
        key_gone = has_key or agent == labyrinth.key  # There the agent hides it.
        found.setdefault((id(labyrinth), key_gone, door_open, seen_from), []).append(place)
    scenes = [Scene(views[places[0]][0], *rest) for (_, *rest), places in found.items()]
    order = np.concatenate(list(found.values()))
    which = np.repeat(np.arange(len(scenes)), list(map(len, found.values())))
    agents = np.array([state.agent for _, state in views])[order]
    with_key = np.array([state.has_key and not state.door_open for _, state in views])[order]
    pictures = np.empty((len(views), image_size, image_size, 3), np.uint8)
    for first, backdrops in backdrops_of(scenes, image_size, style, resize):
        part = slice(*np.searchsorted(which, [first, first + len(backdrops)]))
        backdrops.draw(pictures[part], which[part] - first, agents[part], with_key[part])
    return pictures if (np.diff(order) > 0).all() else pictures[order.argsort()]


def _kind(labyrinth: Labyrinth) -> tuple[Any, ...]:
    """Return what labyrinths must have in common to be drawn together."""
    structure = labyrinth.structure
    return structure.height, structure.width, labyrinth.task, labyrinth.look

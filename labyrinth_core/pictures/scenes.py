"""Pictures of many states at once, the very pixels of `renderer` at any size.

What states have in common is drawn once, and what labyrinths of one size have in common together.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import lru_cache
from typing import Any

import numpy as np

from labyrinth_core.pictures.backdrops import Backdrops, Mask, Scene, Scenes, backdrops_of
from labyrinth_core.pictures.png import PICTURE_SIZE
from labyrinth_core.pictures.renderer import Painter, Style, style_for, style_of
from labyrinth_core.pictures.vector import initial_vectors
from labyrinth_core.pictures.windows import Numbers, Pictures
from labyrinth_core.world.batch_labyrinths import Labyrinths
from labyrinth_core.world.dynamics import State
from labyrinth_core.world.labyrinth import Labyrinth, Task
from labyrinth_core.world.visibility import seen_together


def draw(
    views: Sequence[tuple[Labyrinth, State]],
    image_size: int,
    *,
    wall_pixels: int | None = None,
    resize: str = "area",
    seen_from: Sequence[frozenset[int]] | None = None,
) -> Pictures:
    """Return the pictures of some states of some labyrinths, shape (N, image_size, image_size, 3).

    Args:
        views: Each state with its labyrinth, N of them.
        image_size: Pixels on each side of a picture.
        wall_pixels: The thickness of walls, if it is not that of the labyrinths' looks.
        resize: One of `resize.RESIZES`.
        seen_from: Under partial observability, the cells whose sights each picture shows together;
            None for the agent's own.

    Raises:
        ValueError: A labyrinth is too large for every wall to have a pixel.
    """
    distinct = {id(labyrinth): labyrinth for labyrinth, _ in views}
    styles = {each: style_of(labyrinth, wall_pixels) for each, labyrinth in distinct.items()}
    pictures = np.empty((len(views), image_size, image_size, 3), np.uint8)
    if image_size == PICTURE_SIZE and seen_from is None:  # The renderer's strips are the pixels.
        for place, (each, state) in enumerate(views):
            pictures[place] = _painter(each, styles[id(each)]).array(state)
        return pictures
    if seen_from is None:
        seen_from = [frozenset((state.agent,)) for _, state in views]
    kinds = {each: _kind(labyrinth) for each, labyrinth in distinct.items()}
    groups = {kind: styles[each] for each, kind in kinds.items()}
    if len(groups) == 1:
        (style,) = groups.values()
        return _draw_alike(views, seen_from, image_size, style, resize)
    for kind, style in groups.items():
        places = [place for place, (each, _) in enumerate(views) if kinds[id(each)] == kind]
        some, seen = [views[place] for place in places], [seen_from[place] for place in places]
        pictures[places] = _draw_alike(some, seen, image_size, style, resize)
    return pictures


_painter = lru_cache(maxsize=1)(Painter)
"""The painter of a labyrinth; cached, as consecutive states may be of one labyrinth."""


def _draw_alike(
    views: Sequence[tuple[Labyrinth, State]],
    seen_from: Sequence[frozenset[int]],
    image_size: int,
    style: Style,
    resize: str,
) -> Pictures:
    """Return the pictures of states of labyrinths of one size, task and style."""
    # Labyrinths are told apart by identity: to compare them takes as long as to draw one twice.
    found: dict[tuple[Any, ...], list[int]] = {}
    for place, (labyrinth, (agent, has_key, door_open)) in enumerate(views):
        seen = seen_from[place] if labyrinth.task is Task.PARTIAL_OBSERVABILITY else None
        key_gone = has_key or agent == labyrinth.key  # There the agent hides it.
        found.setdefault((id(labyrinth), key_gone, door_open, seen), []).append(place)
    scenes = [Scene(views[places[0]][0], *rest) for (_, *rest), places in found.items()]
    scene = np.empty(len(views), np.intp)
    for number, places in enumerate(found.values()):
        scene[places] = number
    agents = np.array([state.agent for _, state in views])
    with_key = np.array([state.has_key and not state.door_open for _, state in views])
    pictures = np.empty((len(views), image_size, image_size, 3), np.uint8)
    backdrops = backdrops_of(Scenes.of(scenes), image_size, style, resize)
    _fill(pictures, backdrops, scene, agents, with_key)
    return pictures


def draw_many(
    pictures: Pictures,
    labyrinths: Labyrinths,
    which: Numbers,
    states: Numbers,
    *,
    wall_pixels: int | None = None,
    resize: str = "area",
) -> None:
    """Fill pictures, shape (N, image_size, image_size, 3), with what `draw` returns.

    Args:
        pictures: What to fill, C-contiguous; not of `PICTURE_SIZE`.
        labyrinths: Some labyrinths.
        which: The number of the labyrinth in each picture, shape (N,).
        states: The number of the state in each, as in `dynamics.state_index`, shape (N,).
        wall_pixels: The thickness of walls, if it is not that of the labyrinths' look.
        resize: One of `resize.RESIZES`.

    Raises:
        ValueError: The labyrinths are too large for every wall to have a pixel.
    """
    height, width = labyrinths.structures.height, labyrinths.structures.width
    phase, agents = np.divmod(states, height * width)
    key_gone, door_open = phase > 0, phase > 1
    if labyrinths.task is Task.KEY_AND_DOOR:
        key_gone |= agents == labyrinths.tiles[which, 2]
    hides = labyrinths.task is Task.PARTIAL_OBSERVABILITY
    code = agents if hides else 2 * key_gone + door_open
    kinds = (which * (height * width + 4) + code).astype(np.int64)
    _, first, scene = np.unique(kinds, return_index=True, return_inverse=True)
    some = labyrinths.take(which[first])
    scenes = Scenes(
        height,
        width,
        labyrinths.task,
        initial_vectors(some.structures, some.tiles, some.ice),
        key_gone[first],
        door_open[first],
        _seen(some, agents[first]) if hides else None,
    )
    style = style_for(labyrinths.look, height, width, wall_pixels)
    backdrops = backdrops_of(scenes, pictures.shape[1], style, resize)
    _fill(pictures, backdrops, scene, agents, phase == 1)


def _seen(labyrinths: Labyrinths, agents: Numbers) -> Mask:
    """Return which cells an agent in each of some labyrinths sees, shape (n, height, width)."""
    structures = labyrinths.structures
    shape = len(labyrinths), structures.height, structures.width
    first = shape[1] * shape[2] * np.arange(shape[0])
    moves = (structures.moves() + first[:, None, None]).reshape(-1, 4)
    return seen_together(moves, first + agents, max(shape[1:])).reshape(shape)


def _fill(
    pictures: Pictures,
    backdrops: Iterator[tuple[int, Backdrops]],
    scene: Numbers,
    agents: Numbers,
    with_key: Mask,
) -> None:
    """Fill pictures with the scene and the agent that each shows."""
    order = scene.argsort(kind="stable")
    ascending = scene[order]
    for first, some in backdrops:
        part = slice(*np.searchsorted(ascending, [first, first + len(some)]))
        places = order[part]
        in_order = (np.diff(places) == 1).all()
        drawn = pictures[places[0] :][: len(places)] if in_order else pictures[places]
        some.draw(drawn, ascending[part] - first, agents[places], with_key[places])
        if not in_order:
            pictures[places] = drawn


def _kind(labyrinth: Labyrinth) -> tuple[Any, ...]:
    """Return what labyrinths must have in common to be drawn together."""
    structure = labyrinth.structure
    return structure.height, structure.width, labyrinth.task, labyrinth.look

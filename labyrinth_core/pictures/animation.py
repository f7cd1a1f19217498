"""Animate episodes: GIF files with one frame per state."""

from __future__ import annotations

import io
from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.pictures.renderer import Painter
from labyrinth_core.world import Episode

STEP_SECONDS = 0.3
END_SECONDS = 1.5
"""How long the last frame of an episode is shown."""

Frame = NDArray[np.uint8]


def animate(*episodes: Episode, image_size: int = 300) -> bytes:
    """Return a GIF file that shows one or more episodes side by side, in an endless loop.

    Raises:
        ValueError: A labyrinth is too large for every wall to have a pixel.
        ImportError: Pillow, which writes the file, is not installed.
    """
    return gif([beside(*(frames_of(episode, image_size) for episode in episodes))])


def frames_of(episode: Episode, image_size: int = 300) -> list[Frame]:
    """Return the pictures of an episode's states, T + 1 of shape (image_size, image_size, 3).

    Raises:
        ValueError: The labyrinth is too large for every wall to have a pixel.
    """
    painter = Painter(episode.labyrinth)
    return [painter.array(state, image_size) for state in episode.states]


def beside(*episodes: Sequence[Frame], gap: int = 20) -> list[Frame]:
    """Join several episodes side by side on white; each waits at its end for the longest.

    Args:
        episodes: The frames of each, all of the same shape (image_size, image_size, 3).
        gap: The number of pixels between two episodes.
    """
    between = np.full((len(episodes[0][0]), gap, 3), 255, np.uint8)
    joined = []
    for at in range(max(map(len, episodes))):
        parts = [part for each in episodes for part in (between, each[min(at, len(each) - 1)])]
        joined.append(np.concatenate(parts[1:], axis=1))
    return joined


def gif(episodes: Iterable[Sequence[Frame]]) -> bytes:
    """Return a GIF file that shows episodes one after the other, in an endless loop.

    Up to 256 different colours are kept exactly; more are reduced to 256.

    Args:
        episodes: The frames of one or more episodes, all of the same shape (height, width, 3).

    Raises:
        ValueError: There is no frame, or frames have other or different shapes.
        ImportError: Pillow, which writes the file, is not installed.
    """
    from PIL import Image

    episodes = [*episodes]
    shapes = {np.shape(frame) for frames in episodes for frame in frames}
    if len(shapes) != 1 or [len(shape) for shape in shapes] != [3]:
        found = ", ".join(map(str, sorted(shapes))) or "no frames"
        raise ValueError(f"{found}: give episodes, each a list of frames of one shape (h, w, 3)")
    images, milliseconds = [], []
    for frames in episodes:
        images += [Image.fromarray(frame) for frame in frames]
        milliseconds += [round(1000 * STEP_SECONDS)] * (len(frames) - 1)
        milliseconds.append(round(1000 * END_SECONDS))
    file = io.BytesIO()
    images[0].save(
        file,
        "GIF",
        save_all=True,
        append_images=images[1:],
        duration=milliseconds,
        loop=0,
        optimize=True,
    )
    return file.getvalue()

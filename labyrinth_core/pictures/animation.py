"""Animate episodes: GIF files with one frame per state."""

from __future__ import annotations

import io

import numpy as np

from labyrinth_core.pictures.renderer import Painter
from labyrinth_core.world import Episode

STEP_SECONDS = 0.3
END_SECONDS = 1.5
"""How long the last frame is shown."""

GAP = 20
"""The pixels between two episodes."""


def animate(*episodes: Episode, image_size: int = 300) -> bytes:
    """Return a GIF file that shows one or more episodes side by side, in an endless loop.

    Each episode waits at its end for the longest. Up to 256 different colours are kept exactly;
    more are reduced to 256.

    Raises:
        ValueError: A labyrinth is too large for every wall to have a pixel.
        ImportError: Pillow, which writes the file, is not installed.
    """
    from PIL import Image

    pictures = []
    for each in episodes:
        painter = Painter(each.labyrinth)
        pictures.append([painter.array(state, image_size) for state in each.states])
    between = np.full((image_size, GAP, 3), 255, np.uint8)
    frames = []
    for step in range(max(map(len, pictures))):
        parts = [part for own in pictures for part in (between, own[min(step, len(own) - 1)])]
        frames.append(Image.fromarray(np.concatenate(parts[1:], axis=1)))
    file = io.BytesIO()
    frames[0].save(
        file,
        "GIF",
        save_all=True,
        append_images=frames[1:],
        duration=[*[round(1000 * STEP_SECONDS)] * (len(frames) - 1), round(1000 * END_SECONDS)],
        loop=0,
        optimize=True,
    )
    return file.getvalue()

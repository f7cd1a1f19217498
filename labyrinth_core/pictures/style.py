"""The colours of pictures and the thickness of walls: a `Style` for each look."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

from labyrinth_core.pictures.png import PICTURE_SIZE
from labyrinth_core.world import Look

MAX_PICTURED_SIDE = (PICTURE_SIZE - 1) // 2
"""The most rows and columns with which every cell and wall still has a pixel."""

Colour = tuple[int, int, int]


@dataclass(frozen=True, eq=False)
class Style:
    """The colours, each as red, green and blue from 0 to 255, and the thickness of walls.

    By default start, goal and agent are red, blue and green as in the original, in the shades by
    Okabe and Ito that colour-blind people can tell apart (https://jfly.uni-koeln.de/color/).
    """

    floor: Colour = (255, 255, 255)
    wall: Colour = (0, 0, 0)
    hidden: Colour = (0, 0, 0)
    start: Colour = (213, 94, 0)
    goal: Colour = (0, 114, 178)
    agent: Colour = (0, 158, 115)
    key: Colour = (240, 228, 66)
    door: Colour = (128, 72, 32)
    ice: Colour = (170, 217, 242)
    wall_pixels: int | None = None
    """The thickness in pixels, at most a quarter of a cell; None for a twelfth of a cell, but at
    least two pixels."""


DEFAULT_STYLE = Style()

RECOLOURED = Style(
    floor=(250, 240, 215),
    wall=(70, 40, 90),
    hidden=(70, 40, 90),
    start=(204, 121, 167),
    goal=(86, 180, 233),
    agent=(230, 159, 0),
    key=(240, 90, 90),
    door=(90, 110, 60),
    ice=(190, 225, 190),
)
"""Other colours for everything; none is black or white, and none occurs in `DEFAULT_STYLE`."""


_PLAIN_WORDS = {
    "agent": "the green square",
    "goal": "the blue cell",
    "key": "the yellow square",
    "door": "the brown cell",
    "ice": "the pale blue cells",
}
COLOURS_IN_WORDS = {
    Look.PLAIN: _PLAIN_WORDS,
    Look.RECOLOURED: {
        "agent": "the orange square",
        "goal": "the blue cell",
        "key": "the red square",
        "door": "the dark green cell",
        "ice": "the pale green cells",
    },
    Look.THIN_WALLS: _PLAIN_WORDS,
}
"""Look -> how questions name the agent, the goal and each tile."""


def style_for(look: Look, height: int, width: int, wall_pixels: int | None = None) -> Style:
    """Return the style of a look.

    Args:
        look: The look of the labyrinths.
        height: Their rows of cells.
        width: Their columns of cells.
        wall_pixels: The thickness of walls; None for the thickness of the look.

    Raises:
        ValueError: The labyrinths are too large for every wall to have a pixel.
    """
    if wall_pixels is None and look is Look.THIN_WALLS:
        wall_pixels = max(1, usual_wall_pixels(height, width) // 4)
    return _style(look, wall_pixels)


# Cached, so that equal styles are one object: the caches below compare styles by identity.
@lru_cache(maxsize=64)
def _style(look: Look, wall_pixels: int | None) -> Style:
    style = RECOLOURED if look is Look.RECOLOURED else DEFAULT_STYLE
    return style if wall_pixels is None else replace(style, wall_pixels=wall_pixels)


def usual_wall_pixels(height: int, width: int) -> int:
    """Return the thickness of walls in pixels if the style does not set it.

    Raises:
        ValueError: The labyrinth is too large for every wall to have a pixel.
    """
    most = max(height, width)
    if most > MAX_PICTURED_SIDE:
        raise ValueError(
            f"a {height}x{width} labyrinth does not fit a picture of {PICTURE_SIZE} pixels: "
            f"{MAX_PICTURED_SIDE} rows and columns at most"
        )
    # A twelfth of a cell looks right in small labyrinths; two pixels survive shrinking to 64 x 64.
    return max(PICTURE_SIZE // (12 * most), 2 if PICTURE_SIZE // most >= 4 else 1)

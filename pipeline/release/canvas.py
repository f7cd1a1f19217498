"""A sheet to draw figures on: text legible on a phone, flat colours, and labyrinths.

Figures are 1080 pixels wide, so that on a phone, at a third of that, their text is still about
ten pixels high.
"""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import replace

from PIL import Image, ImageDraw, ImageFont

from labyrinth_core.pictures.renderer import DEFAULT_STYLE, Colour, render
from labyrinth_core.world.dynamics import State, replay
from labyrinth_core.world.labyrinth import Labyrinth, Structure, Task

WIDTH = 1080
MARGIN = 36
TEXT, SMALL = 38, 31
"""Heights of text, in pixels."""

PAPER: Colour = (255, 255, 255)
INK: Colour = (33, 37, 41)
MUTED: Colour = (100, 108, 116)
LINE: Colour = (222, 226, 230)

_FINER = 4
"""The factor by which lines are drawn larger, then shrunk, for smooth edges."""


class Sheet:
    """A white picture to draw on, `WIDTH` wide; x to the right and y downwards, in pixels."""

    def __init__(self, height: int) -> None:
        self.image = Image.new("RGB", (WIDTH, height), PAPER)
        self._draw = ImageDraw.Draw(self.image)

    def text(
        self,
        place: tuple[float, float],
        text: str,
        size: int = TEXT,
        colour: Colour = INK,
        anchor: str = "ls",
    ) -> None:
        """Write a line of text; `anchor` is Pillow's, by default the left end of the baseline."""
        self._draw.text(place, text, fill=colour, font=ImageFont.load_default(size), anchor=anchor)

    def box(self, left: float, top: float, right: float, bottom: float, colour: Colour) -> None:
        """Fill a rectangle; right and bottom are the first pixels outside it."""
        corners = (round(left), round(top), round(right) - 1, round(bottom) - 1)
        if corners[2] >= corners[0] and corners[3] >= corners[1]:
            self._draw.rectangle(corners, fill=colour)

    def labyrinth(
        self, place: tuple[int, int], size: int, labyrinth: Labyrinth, actions: Sequence[int]
    ) -> None:
        """Draw a labyrinth and the route of an episode, without the margins above and below.

        Args:
            place: The left and top edges of the labyrinth, in pixels.
            size: Its width in pixels, or its height if it is taller than wide.
            labyrinth: The labyrinth, drawn with everything that its agent does not see.
            actions: The actions of the episode.
        """
        left, top = place
        picture = picture_with_route(labyrinth, actions, size)
        picture = picture.resize((size, size), Image.Resampling.BOX)
        tall = tallness(labyrinth.structure, size)
        above = (size - tall) // 2
        self.box(left - 1, top - 1, left + size + 1, top + tall + 1, LINE)
        self.image.paste(picture.crop((0, above, size, above + tall)), place)

    def png(self) -> bytes:
        """Return the picture as a PNG file."""
        file = io.BytesIO()
        self.image.save(file, format="PNG")
        return file.getvalue()


def mixed(first: Colour, second: Colour, part: float) -> Colour:
    """Return the colour that is `part` of the way from the first to the second."""
    red, green, blue = (round(a + (b - a) * part) for a, b in zip(first, second, strict=True))
    return red, green, blue


def tallness(structure: Structure, size: int) -> int:
    """Return the height that a labyrinth takes in a square picture `size` pixels wide."""
    return min(size, round(size * structure.height / structure.width))


def picture_with_route(labyrinth: Labyrinth, actions: Sequence[int], size: int) -> Image.Image:
    """Return the picture of a labyrinth at its start with a route, `_FINER` * `size` wide."""
    if labyrinth.task is Task.PARTIAL_OBSERVABILITY:
        labyrinth = replace(labyrinth, task=Task.NAVIGATION)
    states = replay(labyrinth, actions).states
    side = size * _FINER
    image = Image.fromarray(render(labyrinth, states[0]))
    image = image.resize((side, side), Image.Resampling.NEAREST)
    most = max(labyrinth.structure.height, labyrinth.structure.width)
    _draw_route(ImageDraw.Draw(image), _middles(labyrinth, states, side), side / most)
    return image


def _middles(labyrinth: Labyrinth, states: Sequence[State], side: int) -> list[tuple[float, float]]:
    """Return the centres of the agent's cells in a square picture `side` pixels wide."""
    height, width = labyrinth.structure.height, labyrinth.structure.width
    wall = side / (12 * max(height, width))
    pitch = (side - wall) / max(height, width)
    left = (side - wall - width * pitch) / 2 + wall / 2
    bottom = (side - wall + height * pitch) / 2 + wall / 2
    places = [divmod(state.agent, width) for state in states]
    return [(left + (column + 0.5) * pitch, bottom - (row + 0.5) * pitch) for row, column in places]


def _draw_route(draw: ImageDraw.ImageDraw, points: list[tuple[float, float]], cell: float) -> None:
    """Draw a route with a white edge, from the square of the agent to a dot."""
    agent, half = DEFAULT_STYLE.agent, cell * 0.29
    (x, y), (last_x, last_y) = points[0], points[-1]
    line, edge = max(cell * 0.14, 3 * _FINER), cell * 0.045
    draw.line(points, fill=PAPER, width=round(line + 2 * edge), joint="curve")
    draw.rectangle((x - half, y - half, x + half, y + half), fill=agent)
    for colour, radius in ((PAPER, line + edge), (agent, line)):
        corners = (last_x - radius, last_y - radius, last_x + radius, last_y + radius)
        draw.ellipse(corners, fill=colour)
    draw.line(points, fill=agent, width=round(line), joint="curve")

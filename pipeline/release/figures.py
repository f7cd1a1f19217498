"""The pictures of a card, drawn from the counts.

Figures are 1080 pixels wide, so that on a phone, at a third of that, their text is still about
ten pixels high.
"""

from __future__ import annotations

import io
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

from PIL import Image, ImageDraw, ImageFont

from labyrinth_core.data import SPLITS
from labyrinth_core.pictures import DEFAULT_STYLE, Colour, render
from labyrinth_core.world import Labyrinth, State, Structure, Task
from pipeline.inspection import SplitCounts
from pipeline.machinery import count

PICTURES = "pictures"
BANNER = f"{PICTURES}/labyrinth.png"

WIDTH = 1080
MARGIN = 36
TEXT, SMALL = 38, 31
"""Heights of text, in pixels."""

PAPER: Colour = (255, 255, 255)
INK: Colour = (33, 37, 41)
MUTED: Colour = (100, 108, 116)
LINE: Colour = (222, 226, 230)
_DEEP: Colour = (0, 52, 40)

_FINER = 4
"""The factor by which lines are drawn larger, then shrunk, for smooth edges."""

Splits = Mapping[str, SplitCounts]
"""The counts of each split of a dataset, in the order of the table of splits."""


class Sheet:
    """A white picture to draw on, `WIDTH` wide; x to the right and y downwards, in pixels."""

    def __init__(self, height: int) -> None:
        self.image = Image.new("RGB", (WIDTH, height), PAPER)
        self._draw = ImageDraw.Draw(self.image)

    def text(
        self,
        corner: tuple[float, float],
        text: str,
        size: int = TEXT,
        colour: Colour = INK,
        anchor: str = "ls",
    ) -> None:
        """Write a line of text; `anchor` is Pillow's, by default the left end of the baseline."""
        self._draw.text(corner, text, fill=colour, font=ImageFont.load_default(size), anchor=anchor)

    def box(self, left: float, top: float, right: float, bottom: float, colour: Colour) -> None:
        """Fill a rectangle; right and bottom are the first pixels outside it."""
        corners = (round(left), round(top), round(right) - 1, round(bottom) - 1)
        if corners[2] >= corners[0] and corners[3] >= corners[1]:
            self._draw.rectangle(corners, fill=colour)

    def labyrinth(
        self, corner: tuple[int, int], size: int, labyrinth: Labyrinth, actions: Sequence[int]
    ) -> None:
        """Draw a labyrinth and the route of an episode, without the margins above and below.

        Args:
            corner: The left and top edges of the labyrinth, in pixels.
            size: Its width in pixels, or its height if it is taller than wide.
            labyrinth: The labyrinth, drawn with everything that its agent does not see.
            actions: The actions of the episode.
        """
        left, top = corner
        picture = picture_with_route(labyrinth, actions, size)
        picture = picture.resize((size, size), Image.Resampling.BOX)
        tall = tallness(labyrinth.structure, size)
        above = (size - tall) // 2
        self.box(left - 1, top - 1, left + size + 1, top + tall + 1, LINE)
        self.image.paste(picture.crop((0, above, size, above + tall)), corner)

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
    if labyrinth.task.rules.hides:
        labyrinth = replace(labyrinth, task=Task.NAVIGATION)
    states = labyrinth.replay(actions).states
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


class Figure(NamedTuple):
    """One kind of picture; each config has one of each kind."""

    draw: Callable[[Splits], Sheet]
    title: str
    caption: str


def banner(splits: Splits) -> Sheet:
    """Return a labyrinth of train, of validation and of test, side by side."""
    gap = 60
    size = (WIDTH - 2 * gap - 2) // len(SPLITS.sampled)
    tall = tallness(splits["train"].examples[0].labyrinth.structure, size)
    sheet = Sheet(height=tall + 110)
    for number, name in enumerate(SPLITS.sampled):
        split = splits[name]
        left = 1 + number * (size + gap)
        sheet.labyrinth((left, 1), size, *split.examples[0])
        sheet.text((left, tall + 48), name)
        sheet.text((left, tall + 92), count(split.labyrinths, "labyrinth"), SMALL, MUTED)
    return sheet


def labyrinths(splits: Splits) -> Sheet:
    """Return some labyrinths of each split, each with its first episode."""
    gap, heading = 22, 76
    size = (WIDTH - 2 * MARGIN - (SplitCounts.EXAMPLES - 1) * gap) // SplitCounts.EXAMPLES
    tall = tallness(splits["train"].examples[0].labyrinth.structure, size)
    sheet = Sheet(height=len(splits) * (heading + tall) + MARGIN)
    top = 0
    for name, split in splits.items():
        note = f"{count(split.labyrinths, 'labyrinth')}, {count(split.episodes, 'episode')}"
        sheet.text((MARGIN, top + 56), name)
        sheet.text((WIDTH - MARGIN, top + 56), note, SMALL, MUTED, "rs")
        for number, example in enumerate(split.examples):
            left = MARGIN + number * (size + gap)
            sheet.labyrinth((left, top + heading), size, *example)
        top += heading + tall
    return sheet


def visits(splits: Splits) -> Sheet:
    """Return a heat map for each split: the share of its rows with the agent in each cell."""
    columns, gap, heading = 2, 48, 70
    size = (WIDTH - 2 * MARGIN - (columns - 1) * gap) // columns
    rows = -(-len(splits) // columns)
    height, width = splits["train"].visits.shape
    cell = size / max(height, width)
    pitch = heading + round(height * cell)
    sheet = Sheet(height=rows * pitch + 130)
    most = max(float((s.visits / s.rows).max()) for name, s in splits.items() if name != "random")
    for number, (name, split) in enumerate(splits.items()):
        left = MARGIN + number % columns * (size + gap)
        top = number // columns * pitch
        sheet.text((left, top + 50), name)
        _heat_map(sheet, (left, top + heading), cell, split, most)
    _scale(sheet, rows * pitch + 40, most)
    return sheet


def _heat_map(
    sheet: Sheet, corner: tuple[float, float], cell: float, split: SplitCounts, most: float
) -> None:
    shares = split.visits / split.visits.sum()
    height, width = shares.shape
    gap = 3 if cell > 30 else 1 if cell > 6 else 0
    for row in range(height):
        for column in range(width):
            left, top = corner[0] + column * cell, corner[1] + (height - 1 - row) * cell
            share = float(shares[row, column])
            sheet.box(left, top, left + cell - gap, top + cell - gap, _heat(min(1.0, share / most)))
            if cell >= 78:
                ink = PAPER if share > most / 2 else INK
                middle = (left + (cell - gap) / 2, top + (cell - gap) / 2)
                sheet.text(middle, f"{share:.0%}", SMALL, ink, "mm")


def _scale(sheet: Sheet, top: float, most: float) -> None:
    """Draw the colour scale of the heat maps."""
    steps, height = 100, 26
    left, right = MARGIN + 70, WIDTH - MARGIN - 190
    for step in range(steps):
        begin, end = (left + (right - left) * part / steps for part in (step, step + 1))
        sheet.box(begin, top, end + 1, top + height, _heat((step + 0.5) / steps))
    sheet.text((left - 14, top + height / 2), "0%", SMALL, MUTED, "rm")
    label = f"{most:.{0 if most > 0.05 else 1}%} or more"
    sheet.text((right + 14, top + height / 2), label, SMALL, MUTED, "lm")
    sheet.text((WIDTH / 2, top + height + 42), "share of the split's rows", SMALL, MUTED, "ms")


def _heat(part: float) -> Colour:
    """Return white for 0, the agent's green for a half, and a dark green for 1."""
    if part < 0.5:
        return mixed((241, 249, 246), DEFAULT_STYLE.agent, 2 * part)
    return mixed(DEFAULT_STYLE.agent, _DEEP, 2 * part - 1)


FIGURES = {
    "labyrinths": Figure(
        labyrinths,
        "Labyrinths",
        "The first labyrinths of each split, each with its first episode from start (orange) to "
        "goal (blue); of `random`, where the random policy went.",
    ),
    "visits": Figure(
        visits,
        "Visited tiles",
        "In which cells the rows of each split have the agent.",
    ),
}
"""Name of the picture -> what it shows, in the order of the card."""


def picture_path(config: str, figure: str) -> str:
    """Return the path of a config's picture in the dataset's folder."""
    return f"{PICTURES}/{config}-{figure}.png"


def pictures_of(configs: Sequence[str]) -> list[str]:
    """Return the paths of all pictures on the card of some configs."""
    return [BANNER, *(picture_path(config, name) for config in configs for name in FIGURES)]

"""The pictures of a card, drawn from the counts."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple

from labyrinth_core.data.splits import SAMPLED_SPLITS
from labyrinth_core.pictures.renderer import DEFAULT_STYLE, Colour
from pipeline.inspection.counts import EXAMPLES, SplitCounts
from pipeline.machinery.markdown import count
from pipeline.release.canvas import INK, MARGIN, MUTED, PAPER, SMALL, WIDTH, Sheet, mixed, tallness

Splits = Mapping[str, SplitCounts]
"""The counts of each split of a dataset, in the order of the table of splits."""

_DEEP: Colour = (0, 52, 40)


class Figure(NamedTuple):
    """One kind of picture; each config has one of each kind."""

    draw: Callable[[Splits], Sheet]
    title: str
    caption: str


def banner(splits: Splits) -> Sheet:
    """Return a labyrinth of train, of validation and of test, side by side."""
    gap = 60
    size = (WIDTH - 2 * gap - 2) // len(SAMPLED_SPLITS)
    tall = tallness(splits["train"].examples[0].labyrinth.structure, size)
    sheet = Sheet(height=tall + 110)
    for place, name in enumerate(SAMPLED_SPLITS):
        split = splits[name]
        left = 1 + place * (size + gap)
        sheet.labyrinth((left, 1), size, *split.examples[0])
        sheet.text((left, tall + 48), name)
        sheet.text((left, tall + 92), count(split.labyrinths, "labyrinth"), SMALL, MUTED)
    return sheet


def labyrinths(splits: Splits) -> Sheet:
    """Return some labyrinths of each split, each with its first episode."""
    gap, heading = 22, 76
    size = (WIDTH - 2 * MARGIN - (EXAMPLES - 1) * gap) // EXAMPLES
    tall = tallness(splits["train"].examples[0].labyrinth.structure, size)
    sheet = Sheet(height=len(splits) * (heading + tall) + MARGIN)
    top = 0
    for name, split in splits.items():
        note = f"{count(split.labyrinths, 'labyrinth')}, {count(split.episodes, 'episode')}"
        sheet.text((MARGIN, top + 56), name)
        sheet.text((WIDTH - MARGIN, top + 56), note, SMALL, MUTED, "rs")
        for place, example in enumerate(split.examples):
            left = MARGIN + place * (size + gap)
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
    for place, (name, split) in enumerate(splits.items()):
        left = MARGIN + place % columns * (size + gap)
        top = place // columns * pitch
        sheet.text((left, top + 50), name)
        _heat_map(sheet, (left, top + heading), cell, split, most)
    _scale(sheet, rows * pitch + 40, most)
    return sheet


def _heat_map(
    sheet: Sheet, place: tuple[float, float], cell: float, split: SplitCounts, most: float
) -> None:
    shares = split.visits / split.visits.sum()
    height, width = shares.shape
    gap = 3 if cell > 30 else 1 if cell > 6 else 0
    for row in range(height):
        for column in range(width):
            left, top = place[0] + column * cell, place[1] + (height - 1 - row) * cell
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

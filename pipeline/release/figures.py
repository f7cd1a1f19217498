"""The pictures of a card, drawn from the counts."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Mapping
from itertools import accumulate
from typing import NamedTuple

from labyrinth_core.data.splits import SAMPLED_SPLITS
from labyrinth_core.pictures.renderer import DEFAULT_STYLE, Colour
from pipeline.inspection.counts import EXAMPLES, SplitCounts
from pipeline.inspection.statistics import ACTION_COLOURS
from pipeline.machinery.markdown import count
from pipeline.release.canvas import (
    INK,
    LINE,
    MARGIN,
    MUTED,
    PAPER,
    SMALL,
    TEXT,
    WIDTH,
    Sheet,
    mixed,
    tallness,
    text_width,
)

Splits = Mapping[str, SplitCounts]
"""The counts of each split of a dataset, in the order of the table of splits."""

_DEEP: Colour = (0, 52, 40)
_MOST_BARS = 45
"""The largest number of bars of a histogram; of more lengths, neighbours share a bar."""


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
        _heading(sheet, top, name, note)
        for place, example in enumerate(split.examples):
            left = MARGIN + place * (size + gap)
            sheet.labyrinth((left, top + heading), size, *example)
        top += heading + tall
    return sheet


def visits(splits: Splits) -> Sheet:
    """Return a heat map for each split: in which cells its rows have the agent."""
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


def actions(splits: Splits) -> Sheet:
    """Return a bar for each split, divided by how often each action is taken."""
    legend, heading, bar = 84, 66, 64
    sheet = Sheet(height=legend + len(splits) * (heading + bar) + MARGIN)
    left = float(MARGIN)
    for action, colour in ACTION_COLOURS.items():
        sheet.box(left, 30, left + 34, 64, colour)
        sheet.text((left + 48, 60), action.name.lower(), SMALL)
        left += 100 + text_width(action.name.lower())
    top = legend
    for name, split in splits.items():
        _heading(sheet, top - 8, name, count(int(split.actions.sum()), "action"))
        _divided_bar(sheet, top + heading, bar, split)
        top += heading + bar
    return sheet


def _divided_bar(sheet: Sheet, top: float, height: float, split: SplitCounts) -> None:
    shares = [float(split.action_shares[action]) for action in ACTION_COLOURS]
    wide = WIDTH - 2 * MARGIN
    ends = [MARGIN + wide * part for part in accumulate(shares, initial=0.0)]
    for place, (share, colour) in enumerate(zip(shares, ACTION_COLOURS.values(), strict=True)):
        left, right = ends[place], ends[place + 1]
        sheet.box(left, top, right - (place < len(shares) - 1) * 2, top + height, colour)
        if right - left >= text_width(f"{share:.0%}") + 12:
            ink = INK if sum(colour) > 420 else PAPER
            middle = ((left + right) / 2, top + height / 2)
            sheet.text(middle, f"{share:.0%}", SMALL, ink, "mm")


def lengths(splits: Splits) -> Sheet:
    """Return a histogram of the lengths of demonstrations for each split that holds some."""
    shown = {name: split for name, split in splits.items() if name != "random"}
    heading, chart = 84, 150
    sheet = Sheet(height=len(shown) * (heading + chart) + 112)
    bars = _Bars.over(shown.values())
    most = max(max(bars.of(split).values()) / split.episodes for split in shown.values())
    for number, (name, split) in enumerate(shown.items()):
        top = number * (heading + chart)
        note = f"mean {split.mean_moves:.1f}, longest {split.longest:,}"
        _heading(sheet, top, name, note)
        bottom = top + heading + chart
        sheet.box(MARGIN, bottom, WIDTH - MARGIN, bottom + 2, LINE)
        for place, episodes in bars.of(split).items():
            left, tall = MARGIN + place * bars.step, episodes / split.episodes / most * chart
            right = left + bars.step
            sheet.box(left + 2, bottom - tall, right - 2, bottom, DEFAULT_STYLE.agent)
        middle = bars.middle(split.mean_moves)
        sheet.box(middle - 2, bottom - chart, middle + 2, bottom, DEFAULT_STYLE.start)
    _axis(sheet, len(shown) * (heading + chart), bars)
    return sheet


class _Bars(NamedTuple):
    """The horizontal axis of the histograms."""

    first: int
    """The shortest length of the leftmost bar, in moves."""
    together: int
    """The number of lengths that share a bar."""
    number: int
    """The number of bars."""

    @classmethod
    def over(cls, splits: Collection[SplitCounts]) -> _Bars:
        first = min(min(split.lengths) for split in splits)
        span = max(split.longest for split in splits) - first + 1
        together = -(-span // _MOST_BARS)
        return cls(first, together, -(-span // together))

    @property
    def step(self) -> float:
        """The width of a bar, in pixels."""
        return (WIDTH - 2 * MARGIN) / self.number

    def of(self, split: SplitCounts) -> Counter[int]:
        """Return the episodes in each bar."""
        bars: Counter[int] = Counter()
        for moves, episodes in split.lengths.items():
            bars[(moves - self.first) // self.together] += episodes
        return bars

    def middle(self, moves: float) -> float:
        """Return the horizontal place of a number of moves, in pixels."""
        return MARGIN + ((moves - self.first + 0.5) / self.together) * self.step


def _axis(sheet: Sheet, top: float, bars: _Bars) -> None:
    """Label the axis under the lowest histogram, as densely as there is room for."""
    last = bars.first + (bars.number - 1) * bars.together
    room = text_width(f"  {last:,}")
    every = next(n for n in (1, 2, 5, 10, bars.number) if n * bars.step >= room)
    for place in range(0, bars.number, every):
        moves = bars.first + place * bars.together
        middle = MARGIN + (place + 0.5) * bars.step
        sheet.text((middle, top + 44), f"{moves:,}", SMALL, MUTED, "ms")
    sheet.text((WIDTH / 2, top + 92), "moves", SMALL, MUTED, "ms")


def _heading(sheet: Sheet, top: float, text: str, note: str) -> None:
    sheet.text((MARGIN, top + 56), text, TEXT)
    sheet.text((WIDTH - MARGIN, top + 56), note, SMALL, MUTED, "rs")


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
    "actions": Figure(actions, "Actions", "How often each action is taken in each split."),
    "lengths": Figure(
        lengths,
        "Route lengths",
        "Moves of a demonstration in each split that holds some; the orange line is the mean.",
    ),
}
"""Name of the picture -> what it shows, in the order of the card."""

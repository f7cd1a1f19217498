"""Looks in which generalise.py shows labyrinths that a policy was not trained on."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, replace
from functools import partial

import numpy as np

from labyrinth_core.pictures.png import PICTURE_SIZE
from labyrinth_core.pictures.renderer import DEFAULT_STYLE, RECOLOURED, Style
from labyrinth_core.world.labyrinth import Labyrinth

APART = 48
"""How much any two colours of a palette differ at least, in one of red, green and blue."""

Look = Callable[[Sequence[Labyrinth], np.random.Generator], list[Style]]
"""From labyrinths to the style of each."""


def palette(rng: np.random.Generator) -> Style:
    """Return a style of uniformly drawn colours, drawn again until all are apart."""
    names = [field.name for field in fields(Style) if field.name != "wall_pixels"]
    while True:
        colours = rng.integers(256, size=(len(names), 3))
        differences = np.abs(colours[:, None] - colours).max(axis=2)
        if differences[np.triu_indices(len(names), 1)].min() >= APART:
            return Style(**dict(zip(names, map(tuple, colours.tolist()), strict=True)))


def _palettes(labyrinths: Sequence[Labyrinth], rng: np.random.Generator) -> list[Style]:
    return [palette(rng) for _ in labyrinths]


def _recoloured(labyrinths: Sequence[Labyrinth], _: np.random.Generator) -> list[Style]:
    return [RECOLOURED] * len(labyrinths)


def _walls(
    labyrinths: Sequence[Labyrinth], _: np.random.Generator, *, pixels: int = 0, share: int = 1
) -> list[Style]:
    """Return styles with walls of `pixels` pixels, or of one part of a cell in `share`."""
    shapes = [each.structure for each in labyrinths]
    cells = [PICTURE_SIZE // max(each.height, each.width) for each in shapes]
    styles = {cell: replace(DEFAULT_STYLE, wall_pixels=pixels or cell // share) for cell in cells}
    return [styles[cell] for cell in cells]


LOOKS: Mapping[str, Look] = {
    "palettes": _palettes,
    "recoloured": _recoloured,
    "walls of two pixels": partial(_walls, pixels=2),
    "walls of a fifth": partial(_walls, share=5),
    "walls of a quarter": partial(_walls, share=4),
}
"""Name of a look -> the style of each labyrinth."""

"""The looks of generalise.py: palettes of colours that are apart, and walls as they say."""

from __future__ import annotations

import importlib.util
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest

from labyrinth_core.pictures.renderer import DEFAULT_STYLE
from labyrinth_core.world.labyrinth import Labyrinth, Task
from labyrinth_core.world.random_labyrinth import sample_labyrinth

SCRIPT = Path(__file__).parents[3] / "scripts/studies/looks.py"
spec = importlib.util.spec_from_file_location("looks", SCRIPT)
assert spec is not None
assert spec.loader is not None
looks = importlib.util.module_from_spec(spec)
spec.loader.exec_module(looks)


@pytest.fixture(scope="module")
def labyrinths() -> list[Labyrinth]:
    rng = np.random.default_rng(0)
    return [sample_labyrinth(5, 5, Task.NAVIGATION, rng) for _ in range(20)]


def test_every_labyrinth_has_a_palette_of_its_own_whose_colours_are_apart(
    labyrinths: list[Labyrinth],
) -> None:
    once, again = (looks.LOOKS["palettes"](labyrinths, np.random.default_rng(1)) for _ in range(2))
    seen = set()
    for style, same in zip(once, again, strict=True):
        colours = asdict(style)
        assert colours == asdict(same)
        assert colours.pop("wall_pixels") is None
        table = np.array(list(colours.values()))
        apart = np.abs(table[:, None] - table).max(axis=2)[~np.eye(len(table), dtype=np.bool_)]
        assert apart.min() >= looks.APART
        seen.add(tuple(colours.values()))
    assert len(seen) == len(labyrinths)


@pytest.mark.parametrize(
    ("look", "pixels"),
    [("walls of two pixels", 2), ("walls of a fifth", 24), ("walls of a quarter", 30)],
)
def test_walls_have_their_part_of_a_cell_and_all_else_its_colour(
    labyrinths: list[Labyrinth], look: str, pixels: int
) -> None:
    for style in looks.LOOKS[look](labyrinths, np.random.default_rng(0)):
        assert asdict(style) == asdict(DEFAULT_STYLE) | {"wall_pixels": pixels}

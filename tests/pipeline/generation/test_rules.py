"""Rules that no dataset of ours breaks, broken in labyrinths and routes made by hand."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import pytest
from support.making import run_of

from labyrinth_core.world import Action, Labyrinth, Structure, Task
from pipeline.generation.check_rows import labyrinth_problems, route_problems
from pipeline.generation.labyrinths import Solution
from pipeline.generation.shifts import Train

RIGHT, LEFT, UP = Action.RIGHT, Action.LEFT, Action.UP
GRID = Structure.without_walls(3, 3)
OPEN = Labyrinth(GRID, 0, 8)
APART = Structure.from_passages(3, 3, [p for p in GRID.passages() if 6 not in p])
"""Cell 6, at the top left, has walls all around."""
SNAKE = Structure.from_passages(3, 3, pairwise([0, 1, 2, 5, 4, 3, 6, 7, 8]))
"""One route leads from start to goal, through every cell."""


@pytest.mark.parametrize(
    ("labyrinth", "split", "message"),
    [
        (replace(OPEN, structure=APART), "train", "not every cell can be reached"),
        (
            Labyrinth(GRID, 0, 8, Task.ICY_FLOOR, ice=frozenset({4})),
            "train",
            "the tiles of the task make no difference",
        ),
        (
            Labyrinth(SNAKE, 0, 8, Task.KEY_AND_DOOR, key=1, door=5),
            "train",
            "the tiles of the task make no difference",
        ),
        (
            replace(OPEN, task=Task.PARTIAL_OBSERVABILITY),
            "recoloured",
            "more than its look differs from its parent in test",
        ),
    ],
)
def test_a_labyrinth_that_breaks_a_rule_is_named(
    tmp_path: Path, labyrinth: Labyrinth, split: str, message: str
) -> None:
    config = run_of(tmp_path).dataset
    assert message in labyrinth_problems(config, split, labyrinth, OPEN, Train())


@pytest.mark.parametrize(
    ("actions", "solutions", "messages"),
    [
        ([RIGHT, RIGHT, UP, UP], "shortest", []),
        ([RIGHT, RIGHT, UP], "all", ["an episode ends before the goal"]),
        ([RIGHT, LEFT, RIGHT, RIGHT, UP, UP], "all", []),
        ([RIGHT, LEFT, RIGHT, RIGHT, UP, UP], "shortest", ["routes of 6 moves, instead of 4"]),
    ],
)
def test_a_route_that_breaks_a_rule_is_named(
    tmp_path: Path, actions: list[int], solutions: str, messages: list[str]
) -> None:
    config = run_of(tmp_path, solutions=solutions).dataset
    found = Solution([OPEN.replay(actions)], (4, 6))
    assert list(route_problems(config, "train", found)) == messages

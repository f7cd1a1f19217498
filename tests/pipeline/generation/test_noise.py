"""Demonstrators that err: so often as they should, and in rows that replay."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from math import sqrt
from pathlib import Path

import numpy as np
import pytest
from pyarrow.parquet import read_table
from support.making import DemonstrationsConfig, Run
from support.tampering import problems

from labyrinth_core import load_transitions
from labyrinth_core.data import Dataset, Manifest
from labyrinth_core.world import Labyrinth, Solver, State, Task
from pipeline.inspection import routes_of

pytestmark = pytest.mark.slow

Build = Callable[..., Run]

OPTIONS = {"size": "5", "labyrinths": 30, "random_steps": 10}


def noisy(build: Build, folder: Path, noise: float, **options: object) -> Run:
    return build(folder, **OPTIONS | options, demonstrations=DemonstrationsConfig(noise=noise))


def steps(run: Run, split: str = "train") -> list[tuple[Labyrinth, State, int]]:
    """Return labyrinth, state and action of each step of a split."""
    found = []
    for file in Dataset.at(run.folder).files(split):
        for route in routes_of(file):
            state = route.labyrinth.initial
            for action in route.actions:
                found.append((route.labyrinth, state, action))
                state = route.labyrinth.transition(state, action)
    return found


@pytest.mark.parametrize("task", list(map(str, Task)))
def test_so_many_actions_are_optimal_as_the_noise_says(
    build: Build, tmp_path: Path, task: str
) -> None:
    """The rest are those random actions that are not optimal by chance."""
    noise = 0.3
    run = noisy(build, tmp_path, noise, task=task)
    assert problems(run.folder) == []
    of_steps = steps(run)
    rows = [
        Solver(labyrinth).optimal_actions()[labyrinth.state_index(s)]
        for labyrinth, s, _ in of_steps
    ]
    expected = [1 - noise + noise * row.sum() / 4 for row in rows]
    found = sum(bool(row[action]) for row, (_, _, action) in zip(rows, of_steps, strict=True))
    deviation = sqrt(sum(share * (1 - share) for share in expected))
    assert abs(found - sum(expected)) < 3 * deviation
    loaded = load_transitions(run.data_dir, run.dataset.name, image_size=8, optimal=True)
    assert loaded.optimal is not None
    assert np.array_equal(loaded.optimal, rows)
    again = pickle.loads(pickle.dumps(loaded))
    assert np.array_equal(again.optimal, rows)
    assert found < len(rows)


def test_an_episode_that_ends_on_ice_after_as_many_moves_as_a_shortest_route_is_not_optimal(
    build: Build, tmp_path: Path
) -> None:
    run = noisy(build, tmp_path, 0.3, size="4", labyrinths=20, task="icy_floor")
    for split in ("test", "s0"):
        loaded = load_transitions(
            run.data_dir, run.dataset.name, split=split, observation="vector", optimal=True
        )
        assert loaded.optimal is not None
        optimal = loaded.optimal[np.arange(len(loaded)), np.asarray(loaded.actions)]
        table = read_table(run.folder / Manifest.TABLE, filters=[("split", "=", split)])
        assert sum(table["optimal_actions"].to_pylist()) == optimal.sum()

"""The sets of labyrinths of ablate.py and generalise.py, and their results."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import numpy as np
import pytest

from labyrinth_core.evaluation.labyrinth_arrays import load_arrays
from labyrinth_core.world.labyrinth import Task
from pipeline.config.run import Run

SCRIPT = Path(__file__).parents[3] / "scripts/studies/labyrinth_sets.py"
spec = importlib.util.spec_from_file_location("labyrinth_sets", SCRIPT)
assert spec is not None
assert spec.loader is not None
scripts = importlib.util.module_from_spec(spec)
spec.loader.exec_module(scripts)
labyrinth_sets, write_results, read_results = (
    scripts.labyrinth_sets,
    scripts.write_results,
    scripts.read_results,
)


def test_the_sets_are_the_splits_and_what_no_split_has(small_dataset: Run) -> None:
    sets = dict(
        labyrinth_sets(
            small_dataset.data_dir, "3x3", np.random.default_rng(0), sides=[5], labyrinths=30
        )
    )
    assert list(sets)[:5] == ["train", "validation", "test", "s0", "s0_and_g"]
    for split in ("validation", "test"):
        held = load_arrays(small_dataset.data_dir, "3x3", split, observation="vector").labyrinths
        assert sets[split] == list(held)
        for old, new in zip(held, sets[f"{split}, new ends"], strict=True):
            assert old.structure == new.structure
            assert (old.start, old.goal) != (new.start, new.goal)
    known = {each.structure.canonical() for each in sets["train"]}
    assert len(sets["fresh"]) == len(sets["fresh 5x5"]) == 30
    assert not known & {each.structure.canonical() for each in sets["fresh"]}
    assert {(each.structure.height, each.structure.width) for each in sets["fresh 5x5"]} == {(5, 5)}


@pytest.mark.parametrize("task", list(Task))
def test_fresh_labyrinths_are_of_the_task_and_follow_the_generator(
    datasets: Path, task: Task
) -> None:
    config = "3x4" if task is Task.NAVIGATION else f"3x4-{task}"
    once, again = (
        dict(labyrinth_sets(datasets, config, np.random.default_rng(7), sides=[4], labyrinths=3))
        for _ in range(2)
    )
    assert once == again
    assert {each.task for each in once["fresh 4x4"]} == {task}


def test_results_are_read_as_they_were_written(tmp_path: Path) -> None:
    path = tmp_path / "folder" / "run.json"
    write_results(path, {"seed": 3}, {"test": [True, False, True], "s0": [False]})
    kept = read_results(path)
    assert kept["seed"] == 3
    assert {name: each.tolist() for name, each in kept["solved"].items()} == {
        "test": [1, 0, 1],
        "s0": [0],
    }

"""What a hidden test is worth: memorisers fall, and to choose among submissions gains little."""

from __future__ import annotations

import sys
from importlib import import_module
from pathlib import Path

import pytest
from making import make

from labyrinth_core.evaluation.labyrinth_arrays import load_arrays
from pipeline.season.judge import by_chance

sys.path.insert(0, str(Path(__file__).parents[3] / "scripts" / "studies"))
study = import_module("season")
sys.path.pop(0)


@pytest.mark.slow
def test_memorisers_of_a_public_test_fall_on_the_test_of_a_season(tmp_path):
    public = make(tmp_path / "public", "5x5", labyrinths=16, random_steps=5).parent
    lines = study.memorisers(public, study.season_in(tmp_path / "season", 16), {}).splitlines()[2:]
    rows = {cells[1].strip(): [*map(float, cells[2:6])] for cells in (x.split("|") for x in lines)}
    assert rows["a table of the pictures of the public test"] == [1, 1, 0, 0]
    spl, sr, *of_season = rows["route_memory of the public test"]
    assert (spl, sr) == (1, 1)
    assert max(of_season) < 0.5
    learnt = study.as_train(public, tmp_path / "learnt")
    train, test = (load_arrays(*of) for of in ((learnt, "5x5", "train"), (public, "5x5", "test")))
    assert train.labyrinth_ids.tolist() == test.labyrinth_ids.tolist()


def test_choosing_among_submissions_gains_less_than_the_bound_and_asking_gains_more():
    chosen = {number: study.mean_gain(study.choose, number, 200) for number in (1, 10, 100)}
    assert abs(chosen[1]) < 0.02
    assert all(
        0.6 * by_chance(each, 200) < chosen[each] < by_chance(each, 200) for each in (10, 100)
    )
    assert study.mean_gain(study.ask, 100, 200) > 2 * chosen[100]

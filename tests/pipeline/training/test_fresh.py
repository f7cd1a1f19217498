"""`train_labyrinths=fresh`: new labyrinths in each epoch, none of validation or test."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from support.learning import equal_weights, learner_of
from support.making import Run, SplitsConfig, perform

from labyrinth_core import load_arrays
from labyrinth_core.data import SPLITS, Dataset
from labyrinth_core.evaluation import Results
from labyrinth_core.learning import Problem
from labyrinth_core.learning.problem import FreshLabyrinths
from labyrinth_core.pictures import ObservationSpec
from labyrinth_core.world import Structure
from pipeline.config import ConfigError
from pipeline.training import train
from pipeline.training.loop import PROTOCOLS, Progress, fit

VECTORS = ObservationSpec("vector", 64)


def of_size(run: Run, count: int, **changed: Any) -> FreshLabyrinths:
    """Return the fresh labyrinths of a dataset that would have `count` of them."""
    return FreshLabyrinths(replace(run.dataset, labyrinths=count, **changed), VECTORS, 0)


@pytest.mark.slow  # It draws ten thousand labyrinths.
def test_none_of_ten_thousand_is_in_validation_or_test_nor_is_its_mirror_image(
    small_dataset: Run,
) -> None:
    fresh = of_size(small_dataset, 2_500, height=5, width=5)
    seen: set[Structure] = set()
    for epoch in range(4):
        for labyrinth in fresh.labyrinths(epoch):
            structure = labyrinth.structure
            for each in (structure, structure.transposed()):
                assert each.split(small_dataset.dataset.buckets) == "train"
            seen.add(structure)
    assert len(seen) > 9_900


@pytest.mark.parametrize("goals", ["fixed", "varied"])
def test_where_structures_are_few_all_epochs_together_avoid_those_of_other_splits(
    small_dataset: Run, build: Callable[..., Run], tmp_path: Path, goals: str
) -> None:
    run = small_dataset if goals == "fixed" else build(tmp_path, goals=goals)
    held = {
        turned.structure_id
        for split in ("validation", "test")
        for labyrinth in load_arrays(run.data_dir, "3x3", split, observation="vector").labyrinths
        for turned in (labyrinth.structure, labyrinth.structure.transposed())
    }
    fresh = of_size(run, 60, goals=goals)
    drawn = {each.structure.structure_id for epoch in range(8) for each in fresh.labyrinths(epoch)}
    assert len(drawn) > 70
    assert held.isdisjoint(drawn)


def test_an_epoch_is_train_of_a_dataset_with_another_seed(
    problem_of: Callable[..., Problem],
    small_dataset: Run,
    build: Callable[..., Run],
    tmp_path: Path,
) -> None:
    fresh = FreshLabyrinths(small_dataset.dataset, VECTORS, 7)
    problem = fresh.renewed(problem_of(), 3)
    built = build(tmp_path, seed=fresh.config_of(3).seed)
    arrays = load_arrays(built.data_dir, "3x3", "train", observation="vector")
    assert problem.arrays.labyrinths == arrays.labyrinths
    assert np.array_equal(problem.arrays.demonstrated, arrays.demonstrated)
    assert np.array_equal(problem.observations[np.arange(9)], arrays.observations[:9])
    data, spec = Dataset(built.data_dir, "3x3"), problem.spec
    of_built = Problem.of_dataset(data, arrays, spec, learner="a test")
    loaded = {"train": of_built.demonstrations, "random": of_built.exploration()}
    for split, steps in (
        ("train", problem.demonstrations),
        ("random", problem.exploration()),
    ):
        assert all(map(np.array_equal, steps, loaded[split]))
    again, other = fresh.renewed(problem, 3), fresh.renewed(problem, 4)
    assert again.arrays.labyrinths == arrays.labyrinths != other.arrays.labyrinths
    assert FreshLabyrinths(small_dataset.dataset, VECTORS, 8).config_of(3) != fresh.config_of(3)


@pytest.mark.slow  # A checkpoint is written and read after each epoch.
@pytest.mark.parametrize("name", ["bc", "dagger", "bco", "iupe"])
def test_a_run_killed_after_any_epoch_ends_as_if_it_had_not_been(
    problem_of: Callable[..., Problem], small_dataset: Run, tmp_path: Path, name: str
) -> None:
    fresh = FreshLabyrinths(small_dataset.dataset, VECTORS, 0)
    given = {"epochs": 3, "evaluate_every": 3}
    given |= {"epochs_a_round": 2} if name in ("bco", "iupe") else {}
    shown: list[int] = []

    def renewed(problem: Problem, epoch: int) -> Problem:
        shown.append(epoch)
        return fresh.renewed(problem, epoch)

    def trained(path: Path, ends: int = 9) -> dict[str, torch.Tensor]:
        learner = learner_of(name, renewed(problem_of(renewed=renewed), 0), **given)

        def report(done: Progress) -> None:
            if done.epoch == ends:
                raise KeyboardInterrupt

        def judge(_: Any) -> dict[str, float]:
            return {"validation_sr": 0.5}

        fit(learner, judge, PROTOCOLS["default"], path, {}, report, checkpoint_seconds=0)
        weights: dict[str, torch.Tensor] = learner.policy.state_dict()
        return weights

    whole = trained(tmp_path / "whole")
    assert shown == [0, 0, 1, 2]
    for ends in (1, 2):
        with pytest.raises(KeyboardInterrupt):
            trained(tmp_path / "killed", ends)
    assert equal_weights(whole, trained(tmp_path / "killed"))
    assert shown[4:] == [0, 0, 0, 1, 0, 2]


def test_dagger_labels_the_states_that_it_visits_in_the_labyrinths_of_the_epoch(
    problem_of: Callable[..., Problem], small_dataset: Run
) -> None:
    fresh = FreshLabyrinths(small_dataset.dataset, VECTORS, 0)
    learner = learner_of("dagger", problem_of(renewed=fresh.renewed))
    added = 0
    for epoch in range(3):
        learner.renew(fresh.renewed(learner.problem, epoch))
        learner.epoch()
        own = len(learner.problem.demonstrations.states)
        optimal = learner.problem.arrays.optimal
        assert optimal[learner.states[own:], learner.labels[own:]].all()
        assert epoch or len(learner.states) == own
        added += len(learner.states) - own
    assert added


def test_bco_labels_the_demonstrations_of_each_epoch_also_between_two_rounds(
    problem_of: Callable[..., Problem], small_dataset: Run
) -> None:
    fresh = FreshLabyrinths(small_dataset.dataset, VECTORS, 0)
    learner = learner_of("bco", problem_of(renewed=fresh.renewed), epochs_a_round=2)
    for epoch in range(3):
        learner.renew(fresh.renewed(learner.problem, epoch))
        learner.epoch()
        shown = learner.problem.demonstrations
        scores = learner.outputs(learner.model, shown.states, shown.next_states)
        assert np.allclose(learner.scores, scores, atol=1e-6)


@pytest.mark.slow  # It trains and evaluates.
def test_a_run_is_evaluated_under_a_name_of_its_own(
    small_dataset: Run, make_run: Callable[..., Run], tmp_path: Path
) -> None:
    method = {"name": "bc", "epochs": 2}
    run = make_run(
        small_dataset.data_dir,
        stages=["train"],
        run_dir=str(tmp_path / "runs"),
        method=method,
        train_labyrinths="fresh",
    )
    train.run(run)
    perform("evaluate", run)
    assert run.training_folder.name == "bc-cnn-seed0-fresh"
    results = Results.load(run.training_folder / "results.json")
    assert results.run.of_all_seeds == "bc-cnn-fresh"
    content = json.loads((run.training_folder / "results.json").read_text(encoding="utf-8"))
    assert content["run"]["train_labyrinths"] == "fresh"
    assert {content["splits"][split]["labyrinths"] for split in SPLITS.evaluated} == {8}


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ({"method": {"name": "gail"}}, "method=gail learns from the same labyrinths in each epoch"),
        ({"train_labyrinths": "new"}, "train_labyrinths=new: give a whole number, 1 or more, or f"),
    ],
)
def test_what_cannot_learn_from_them_is_refused_in_one_line(
    small_dataset: Run,
    make_run: Callable[..., Run],
    tmp_path: Path,
    options: dict[str, Any],
    told: str,
) -> None:
    given = {"method": {"name": "bc"}, "train_labyrinths": "fresh"} | options
    with pytest.raises(ConfigError) as caught:
        train.refuse(
            make_run(small_dataset.data_dir, run_dir=str(tmp_path), stages=["train"], **given)
        )
    assert told in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_dataset_with_splits_several_walls_apart_is_refused(
    build: Callable[..., Run], make_run: Callable[..., Run], tmp_path: Path
) -> None:
    split = SplitsConfig(2)
    data = build(tmp_path, size="4", splits=split)
    given: dict[str, Any] = {"method": {"name": "bc"}, "train_labyrinths": "fresh"}
    given |= {"stages": ["train"], "run_dir": str(tmp_path / "runs"), "size": "4", "splits": split}
    with pytest.raises(ConfigError, match=r"\Atrain_labyrinths=fresh: .* splits\.min_walls=2 a"):
        train.run(make_run(data.data_dir, **given))

"""The planner plans correctly, does what all methods do, and generalises where BC fails."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import islice
from typing import Any

import numpy as np
import pytest
import torch
from support.learning import learner_of, method_of, settings_of
from support.making import Run
from support.policies import RELEASED
from torch import nn

from labyrinth_core import load_arrays, load_policy
from labyrinth_core.evaluation import LabyrinthArrays, Player, PolicyError
from labyrinth_core.learning import NetworkSpec, Problem
from labyrinth_core.pictures import ObservationSpec, render
from labyrinth_core.world import Labyrinth, Look, State, Structure

pytestmark = pytest.mark.slow

Problems = Callable[..., Problem]

SPEC = NetworkSpec("planner", 5, 5, "navigation")
TOY: dict[str, Any] = {"epochs": 8, "pictures": 384, "iterations": 10, "channels": 16}


def toy(problem: Problem, **settings: Any) -> Any:
    return learner_of("planner", problem, **TOY | settings)


def costs_of(**where: float) -> torch.Tensor:
    """Return the logarithms of costs in a corridor of three positions, the goal at the right."""
    costs = torch.zeros(1, 5, 1, 3)
    costs[:, 4] = 9.0
    costs[:, 4, 0, 2] = -9.0
    for name, cost in where.items():
        costs[0, ["up", "right", "down", "left"].index(name)] = cost
    return costs


def bellman(sharpness: float = 1.0) -> Any:
    """Return the planning of a planner that is given the costs themselves."""
    settings = settings_of("planner", average=False, iterations=5, sharpness=sharpness)
    planning: Any = method_of("planner").make(SPEC, settings).planning
    planning.costs = nn.Identity()
    return planning


def test_costs_add_up_along_the_way() -> None:
    scores = bellman().train()(costs_of(left=1.0))
    e = float(np.exp(1.0))
    assert torch.allclose(scores[0, 1, 0, :2], torch.tensor([-2.0, -1.0]), atol=1e-3)
    assert torch.allclose(scores[0, 3, 0, 1:], torch.tensor([-(e + 2), -(e + 1)]), atol=1e-3)
    assert (scores[0, [0, 2]] < -1e8).all()  # They end outside the picture.


def test_planning_ends_when_it_rests_however_long_the_way_is() -> None:
    long = torch.zeros(1, 5, 1, 200)
    long[:, 4] = 9.0
    long[:, 4, 0, 0] = -9.0
    scores = bellman().eval()(long)
    assert (scores.argmax(1)[0, 0, 1:] == 3).all()
    assert not (bellman().train()(long).argmax(1)[0, 0, 1:] == 3).all()


def test_sharpness_makes_a_wall_dearer_than_many_steps() -> None:
    around = torch.zeros(1, 5, 2, 12)
    around[:, 4] = 9.0
    around[:, 4, 0, 0] = -9.0
    around[:, [0, 2]] = 2.0  # A wall between the rows, but for the last column, costs seven steps.
    around[:, [0, 2], :, -1] = 0.0
    assert bellman(sharpness=1.0).eval()(around)[0, :, 1, 0].argmax() == 0
    assert bellman(sharpness=3.0).eval()(around)[0, :, 1, 0].argmax() == 1


@pytest.mark.parametrize("grid_prior", [True, False])
def test_costs_of_cells_are_sharpened_and_those_of_parts_of_cells_are_not(
    problem_of: Problems, grid_prior: bool
) -> None:
    problem = problem_of(encoder="cnn")
    plain, sharp = (
        toy(problem_of(encoder="cnn"), grid_prior=grid_prior, sharpness=sharpness)
        for sharpness in (1.0, 3.0)
    )
    scores = [each.outputs(each.policy) for each in (plain, sharp)]
    assert torch.equal(*scores) == (not grid_prior)
    pictures = problem.observations[np.arange(len(problem.observations))]
    training = [each.policy.train()(pictures) for each in (plain, sharp)]
    assert torch.equal(*training)


def test_without_the_grid_prior_the_network_is_not_told_how_large_a_cell_is() -> None:
    pictures = torch.randint(256, (4, 64, 64, 3), dtype=torch.uint8)
    for grid_prior in (True, False):
        scores = []
        for side in (3, 5):
            torch.manual_seed(0)
            spec = NetworkSpec("planner", side, side, "navigation")
            settings = settings_of("planner", grid_prior=grid_prior, colour_prior=False)
            scores.append(method_of("planner").make(spec, settings)(pictures))
        assert torch.equal(*scores) == (not grid_prior)


@pytest.mark.parametrize("prior", ["path_prior", "grid_prior", "colour_prior"])
def test_every_prior_can_be_taken_away(problem_of: Problems, prior: str) -> None:
    learner = toy(problem_of(encoder="cnn"), **{prior: False}, pictures=32)
    before = {name: each.clone() for name, each in learner.policy.named_parameters()}
    assert learner.epoch()["loss"] > 0
    after = dict(learner.policy.named_parameters())
    assert all(not torch.equal(each, after[name]) for name, each in before.items())
    assert learner.outputs(learner.policy).isfinite().all()


def test_the_ingredients_are_there_for_behavioural_cloning_too(problem_of: Problems) -> None:
    ingredients = {"augment": True, "relabel": True, "average": True, "pictures": 64}
    learner = learner_of("bc", problem_of(encoder="cnn"), **ingredients)
    losses = [learner.epoch()["loss"] for _ in range(8)]
    assert np.mean(losses[-3:]) < np.mean(losses[:3])


def test_it_solves_labyrinths_never_seen(problem_of: Problems, small_dataset: Run) -> None:
    # After 8 epochs it solves 4 to 7 of 8, depending on the seed and on the processor.
    learner = toy(problem_of(encoder="cnn"), epochs=20)
    for _ in range(learner.settings.epochs):
        learner.epoch()
    held_out = load_arrays(small_dataset.data_dir, "3x3", "test")
    assert Player.of(learner.acting).success_rate(held_out) >= 0.75


def test_the_released_policy_solves_fresh_labyrinths_and_scores_another_colour_in_numbers() -> None:
    policy: Any = load_policy(RELEASED)
    structures = Structure.sample(
        5, 5, np.random.default_rng(2**20), algorithm="wilson", open_walls=0.08
    )
    labyrinths = [Labyrinth(structure, 0, 24) for structure in islice(structures, 20)]
    pictures = ObservationSpec("image", 64, draw=True)
    assert (
        Player.of(policy).success_rate(LabyrinthArrays.of_labyrinths(labyrinths, pictures)) >= 0.9
    )
    recoloured = replace(labyrinths[0], look=Look.RECOLOURED)
    assert np.isfinite(policy(np.stack([render(recoloured, State(7), 64)]))).all()


def test_larger_labyrinths_are_shown_in_as_many_pixels_a_cell_and_rectangles_refused() -> None:
    planner, settings = method_of("planner"), settings_of("planner")
    assert planner.image_size(SPEC, settings, 5, 5) == 64
    assert planner.image_size(SPEC, settings, 10, 10) == 128
    refused = r"\Asize=4x6: method\.grid_prior=true needs as many rows .*method.grid_prior=false\Z"
    with pytest.raises(PolicyError, match=refused):
        planner.image_size(SPEC, settings, 4, 6)
    oblong = NetworkSpec("planner", 4, 6, "navigation")
    with pytest.raises(PolicyError, match=refused):
        planner.make(oblong, settings)
    freely = settings_of("planner", grid_prior=False, colour_prior=False)
    assert planner.image_size(SPEC, freely, 4, 6) == 77
    pictures = torch.zeros(2, 64, 64, 3, dtype=torch.uint8)
    assert planner.make(oblong, freely)(pictures).shape == (2, 4)
    assert method_of("bc").image_size(SPEC, settings_of("bc"), 4, 6) == 64

"""The controls of the planner in scripts/: exchanged actions, other looks, other powers."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from importlib import import_module
from math import exp, log
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
import torch
from method_settings import settings_of
from torch import nn

from labyrinth_core.pictures.renderer import DEFAULT_STYLE, render
from labyrinth_core.policies.networks.acting import NetworkPolicy
from labyrinth_core.policies.networks.planning import Planner
from labyrinth_core.world.dynamics import initial
from pipeline.training.methods.method import Problem

pytestmark = pytest.mark.slow

Problems = Callable[..., Problem]
SCRIPTS = Path(__file__).parents[3] / "scripts/studies"


@pytest.fixture(scope="module")
def script() -> Iterator[Callable[[str], ModuleType]]:
    """A function that imports a script."""
    sys.path.insert(0, str(SCRIPTS))
    yield import_module
    sys.path.remove(str(SCRIPTS))


@pytest.mark.parametrize("whole", [True, False])
def test_two_labels_are_exchanged_and_nothing_else(
    problem_of: Problems, script: Callable[[str], ModuleType], whole: bool
) -> None:
    arrays, ablate = problem_of(encoder="cnn").arrays, script("ablate")
    (pictures, labels), (same, exchanged) = (
        sampler(arrays).draw(64, np.random.default_rng(0), relabel=True, whole=whole)
        for sampler in (ablate.ExampleSampler, ablate.ExchangedSampler)
    )
    assert np.array_equal(pictures, same)
    assert set(np.unique(labels)) >= {0, 1, 2, 3}
    expected = np.where(labels == 0, 1, np.where(labels == 1, 0, labels))
    assert np.array_equal(exchanged, expected)
    back = ablate.EXCHANGE[:-1]
    assert np.array_equal(np.eye(4)[back][:, back], np.eye(4))  # Answers, exchanged back.


def test_only_what_a_look_says_is_other_than_usual(
    problem_of: Problems, script: Callable[[str], ModuleType]
) -> None:
    arrays, controls = problem_of(encoder="cnn").arrays, script("controls")
    looks = controls.all_looks()
    assert np.array_equal(controls.drawn_by(looks["as trained"], arrays), arrays.observations)
    labyrinth = arrays.labyrinths[0]
    usual, state = render(labyrinth, initial(labyrinth), 64), initial(labyrinth)
    inverted = looks["inverted"](labyrinth, state).astype(int)
    assert np.abs(255 - usual.astype(int) - inverted).max() <= 1  # Averages are rounded.
    lighter = looks["agent lighter"](labyrinth, state).astype(int) - usual
    assert set(np.unique(lighter[(lighter != 0).any(2)].max(1))) <= set(range(1, 31))
    assert lighter.max() == 30


def test_thick_walls_cover_what_walls_cover_and_more(
    problem_of: Problems, script: Callable[[str], ModuleType]
) -> None:
    controls = script("controls")
    labyrinth = problem_of(encoder="cnn").arrays.labyrinths[0]
    thick = controls.thickened(labyrinth, initial(labyrinth))
    assert thick.shape == (64, 64, 3)
    usual = render(labyrinth, initial(labyrinth), 64).astype(int)
    assert (thick <= usual).all()
    assert DEFAULT_STYLE.wall == (0, 0, 0)
    assert 0.05 < (thick < usual).mean() < 0.5


def test_the_power_that_is_needed_makes_a_wall_dearer_than_all_cells(
    problem_of: Problems, script: Callable[[str], ModuleType]
) -> None:
    controls, problem = script("controls"), problem_of(encoder="cnn")
    assert 4.0 ** controls.power_for(8, log(4.0)) == pytest.approx(64)
    assert controls.power_for(8, -0.1) == float("inf")
    planner = Planner(64 / 3, settings_of("planner"))
    # A scene that shows the walls of the pictures, each of which costs five steps.
    stays = np.array([each.structure.moves for each in problem.arrays.labyrinths])
    walls = (stays == np.arange(9)[:, None]).transpose(0, 2, 1).reshape(-1, 4, 3, 3)[:, :, ::-1]
    costs = torch.zeros(len(problem.arrays.labyrinth), 5, 3, 3)
    costs[:, :4] = torch.from_numpy(walls[problem.arrays.labyrinth] * log(5.0))
    planner.planning.costs = nn.Identity()  # type: ignore[assignment]
    parts = iter(costs.split(256))
    planner.see = lambda _: next(parts)  # type: ignore[method-assign]
    margin = controls.margin_of(NetworkPolicy(planner), problem.arrays)
    assert exp(margin) == pytest.approx(5.0)

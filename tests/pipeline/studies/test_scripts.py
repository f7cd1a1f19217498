"""The scripts of studies: sets of labyrinths, looks, and the controls of the planner."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import asdict
from importlib import import_module
from math import exp, log
from pathlib import Path

import numpy as np
import pytest
import torch
from learning import settings_of
from torch import nn

from labyrinth_core.evaluation.labyrinth_arrays import load_arrays
from labyrinth_core.pictures.renderer import DEFAULT_STYLE, render
from labyrinth_core.policies.networks.acting import NetworkPolicy
from labyrinth_core.policies.networks.planning import Planner
from labyrinth_core.world.dynamics import initial
from labyrinth_core.world.labyrinth import Labyrinth, Task
from labyrinth_core.world.random_labyrinth import sample_labyrinth
from pipeline.config.run import Run
from pipeline.studies.results.paper import paper_figures
from pipeline.training.methods.method import Problem

pytestmark = pytest.mark.slow

Problems = Callable[..., Problem]

sys.path.insert(0, str(Path(__file__).parents[3] / "scripts" / "studies"))
NAMES = ("ablate", "controls", "generalise", "kept_results", "labyrinth_sets", "looks")
ablate, controls, generalise, kept_results, labyrinth_sets, looks = map(import_module, NAMES)
report_authors, slot_controls = map(import_module, ("report_authors", "slot_controls"))
sys.path.pop(0)


# Sets of labyrinths, and results.


def test_the_sets_are_the_splits_and_what_no_split_has(small_dataset: Run) -> None:
    sets = dict(
        labyrinth_sets.labyrinth_sets(small_dataset.data_dir, "3x3", sides=[5], labyrinths=30)
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
        dict(labyrinth_sets.labyrinth_sets(datasets, config, sides=[4], labyrinths=3))
        for _ in range(2)
    )
    assert once == again
    assert {each.task for each in once["fresh 4x4"]} == {task}


def test_results_are_read_as_they_were_written(tmp_path: Path) -> None:
    path = tmp_path / "folder" / "run.json"
    labyrinth_sets.write_results(path, {"seed": 3}, {"test": [True, False, True], "s0": [False]})
    kept = kept_results.read_run(path)
    assert kept["seed"] == 3
    assert {name: each.tolist() for name, each in kept["solved"].items()} == {
        "test": [1, 0, 1],
        "s0": [0],
    }


# Looks.


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


def test_a_moved_picture_repeats_its_border(labyrinths: list[Labyrinth]) -> None:
    shown = [(labyrinths[0], initial(labyrinths[0]))]
    usual, moved = (
        generalise.Drawing(labyrinths, [None] * 20, pixels, 120).look(shown)[0]
        for pixels in (0, 20)
    )
    assert np.array_equal(moved[20:, 20:], usual[:-20, :-20])
    assert (moved[:20, 20:] == usual[0, :-20]).all()
    assert (moved[20:, :20] == usual[:-20, :1]).all()


# Controls.


@pytest.mark.parametrize("whole", [True, False])
def test_two_labels_are_exchanged_and_nothing_else(problem_of: Problems, whole: bool) -> None:
    arrays = problem_of(encoder="cnn").arrays
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


def test_only_what_a_look_says_is_other_than_usual(problem_of: Problems) -> None:
    arrays = problem_of(encoder="cnn").arrays
    looks = controls.all_looks()
    labyrinth = arrays.labyrinths[0]
    usual, state = arrays.observations[arrays.initial[0]], initial(labyrinth)
    (as_trained,) = controls.InLook(looks["as trained"]).look([(labyrinth, state)])
    assert np.array_equal(as_trained, usual)
    inverted = looks["inverted"](labyrinth, state).astype(int)
    assert np.abs(255 - usual.astype(int) - inverted).max() <= 1  # Averages are rounded.
    lighter = looks["agent lighter"](labyrinth, state).astype(int) - usual
    assert set(np.unique(lighter[(lighter != 0).any(2)].max(1))) <= set(range(1, 31))
    assert lighter.max() == 30


def test_thick_walls_cover_what_walls_cover_and_more(problem_of: Problems) -> None:
    labyrinth = problem_of(encoder="cnn").arrays.labyrinths[0]
    thick = controls.thickened(labyrinth, initial(labyrinth))
    assert thick.shape == (64, 64, 3)
    usual = render(labyrinth, initial(labyrinth), 64).astype(int)
    assert (thick <= usual).all()
    assert DEFAULT_STYLE.wall == (0, 0, 0)
    assert 0.05 < (thick < usual).mean() < 0.5


def test_the_power_that_is_needed_makes_a_wall_dearer_than_all_cells(problem_of: Problems) -> None:
    problem = problem_of(encoder="cnn")
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


# Verdicts on the paper's cells.


@pytest.mark.parametrize(
    ("cell", "ours", "theirs", "verdict"),
    [
        (("5x5", "train", "bc"), 0.37, None, "impossible"),
        (("5x5", "test", "bc"), 0.04, None, "reproduced"),
        (("5x5", "test", "bc"), 0.48, 0.06, "explained"),
        (("5x5", "test", "bc"), 0.48, 0.30, "open"),
        (("5x5", "test", "bc"), 0.48, None, "open"),
    ],
)
def test_a_cell_of_the_paper_has_the_first_verdict_that_holds(
    cell: tuple[str, str, str], ours: float, theirs: float | None, verdict: str
) -> None:
    figure = paper_figures()[cell]
    assert report_authors.judge(figure, ours, theirs) == (figure.sr, theirs, ours, verdict)


# BC and a value iteration network on the mapper's slots.

SLOTS = pytest.mark.parametrize("variant", list(slot_controls.VARIANTS))


@SLOTS
def test_on_slots_the_loss_falls_and_the_colours_of_a_picture_change_nothing(
    problem_of: Problems, labyrinths: list[Labyrinth], variant: str
) -> None:
    problem = problem_of()
    learner = slot_controls.Cloning(problem, slot_controls.settings_of(variant))
    losses = [learner.epoch()["loss"] for _ in range(4)]
    assert losses[-1] < losses[0]
    act = NetworkPolicy(learner.policy)
    usual = slot_controls.shown_as_slots(labyrinths, [None] * len(labyrinths))
    styles = looks.LOOKS["palettes"](labyrinths, np.random.default_rng(0))
    palettes = slot_controls.shown_as_slots(labyrinths, styles)
    seen, same = (each.observations[each.initial] for each in (usual, palettes))
    assert np.array_equal(seen, same)
    assert act(seen).shape == (len(labyrinths), 4)  # Of 5x5, after training at 3x3.


def test_slots_are_varied_unless_a_variant_says_otherwise(problem_of: Problems) -> None:
    for variant, varies in (("slots-bc", True), ("slots-bc-plain", False)):
        learner = slot_controls.Cloning(problem_of(), slot_controls.settings_of(variant))
        once, again = (learner.draw(np.arange(8), 0)[0] for _ in range(2))
        assert torch.equal(once, again) != varies

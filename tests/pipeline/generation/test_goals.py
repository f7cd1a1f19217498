"""`goals=varied`: every labyrinth has a start and a goal of its own, recomputed from the texts."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from support.brute_force import Place, Shown, fewest_moves, is_connected, shown
from support.making import DemonstrationsConfig, Run, SplitsConfig
from support.tampering import problems, replace_first

from labyrinth_core.data import SPLITS, Manifest
from labyrinth_core.language import parse
from labyrinth_core.world import Task

pytestmark = pytest.mark.slow

Build = Callable[..., Run]

OPTIONS = {"size": "5", "labyrinths": 20, "random_steps": 20, "goals": "varied"}


@pytest.fixture(scope="session")
def navigation(build: Build, tmp_path_factory: pytest.TempPathFactory) -> Run:
    """A dataset of navigation with all shifts."""
    return build(tmp_path_factory.mktemp("varied"), **OPTIONS, shifts=("all",))


@pytest.fixture(scope="session", params=list(map(str, Task)))
def varied(
    request: pytest.FixtureRequest, build: Build, tmp_path_factory: pytest.TempPathFactory
) -> Run:
    if request.param == "navigation":
        return request.getfixturevalue("navigation")
    folder, shifts = tmp_path_factory.mktemp("varied"), ("g", "one_wall", "recoloured")
    return build(folder, **OPTIONS, task=request.param, shifts=shifts)


@pytest.fixture(scope="session")
def tiny(build: Build, tmp_path_factory: pytest.TempPathFactory) -> Run:
    """A dataset of the size at which most structures are images of others."""
    return build(tmp_path_factory.mktemp("tiny"), labyrinths=32, random_steps=5, goals="varied")


@pytest.fixture
def folder(navigation: Run, tmp_path: Path) -> Path:
    """A copy of it, to be tampered with."""
    return Path(shutil.copytree(navigation.folder, tmp_path / navigation.folder.name))


def ends(each: Shown) -> tuple[Place, Place]:
    return each.labyrinth.start, each.labyrinth.goal


def apart(each: Shown) -> int:
    return sum(abs(a - b) for a, b in zip(*ends(each), strict=True))


# What the option says, from the texts alone.


def test_what_was_built_is_valid(varied: Run) -> None:
    assert Manifest.read(varied.folder).config.goals == "varied"
    assert problems(varied.folder) == []


@pytest.mark.parametrize(
    "options",
    [
        {"size": "3x2", "labyrinths": 1},
        {"size": "3x5", "shifts": ("g", "one_wall", "trees")},
        {"size": "4", "splits": SplitsConfig(2), "shifts": ("g", "open")},
        {"size": "4", "demonstrations": DemonstrationsConfig(noise=0.2)},
        {"size": "4", "solutions": "all"},
    ],
    ids=str,
)
def test_it_goes_with_other_options(build: Build, tmp_path: Path, options: dict[str, Any]) -> None:
    run = build(tmp_path, **{"labyrinths": 6, "random_steps": 5} | options, goals="varied")
    assert problems(run.folder) == []


@pytest.mark.parametrize("split", SPLITS.sampled)
def test_every_labyrinth_has_ends_of_its_own_that_are_far_enough_apart(
    varied: Run, split: str
) -> None:
    found = shown(varied.folder, split)
    assert all(apart(each) >= 5 for each in found)
    assert len(set(map(ends, found))) > 10
    assert len({each.labyrinth.goal for each in found}) > 5
    assert all(is_connected(5, 5, each.labyrinth.passages) for each in found)
    assert all(len(each.actions) == fewest_moves(each.labyrinth) for each in found)


@pytest.mark.parametrize(
    ("split", "moved"), [("random", ()), ("s0", (0,)), ("g", (1,)), ("s0_and_g", (0, 1))]
)
def test_ends_move_from_those_that_train_has_in_the_same_structure(
    varied: Run, split: str, moved: tuple[int, ...]
) -> None:
    parents = {each.number: each for each in shown(varied.folder, "train")}
    children = shown(varied.folder, split)
    assert len(children) > 10
    for child in children:
        parent = parents[child.number]
        assert child.labyrinth.passages == parent.labyrinth.passages
        for place, (mine, its) in enumerate(zip(ends(child), ends(parent), strict=True)):
            assert (mine != its) == (place in moved)
        assert apart(child) >= 5 or len(moved) == 1
        if split == "random":
            assert child.text == parent.text


def test_no_structure_of_a_split_is_a_rotation_or_reflection_of_one_in_another(tiny: Run) -> None:
    """Any image may have its ends turned as well, and be the same labyrinth then."""
    of = {
        split: [{*parse(each.text).structure.symmetries()} for each in shown(tiny.folder, split)]
        for split in SPLITS.sampled
    }
    owner = {image: split for split in of for images in of[split] for image in images}
    for split, found in of.items():
        assert all(owner[image] == split for images in found for image in images)
    # In the three buckets there are such structures, but for the rule.
    buckets = tiny.dataset.buckets
    mixed = [{image.split(buckets) for image in images} for images in of["train"]]
    assert sum(len(splits) > 1 for splits in mixed) > 10


def test_a_structure_is_where_it_would_be_with_fixed_goals(tiny: Run) -> None:
    """So nothing that a policy learns from is in test of any dataset with the same buckets."""
    for split in SPLITS.sampled:
        for each in shown(tiny.folder, split):
            assert parse(each.text).structure.split(tiny.dataset.buckets) == split


def test_another_seed_draws_other_ends(build: Build, tmp_path: Path, tiny: Run) -> None:
    other = build(tmp_path, labyrinths=32, random_steps=5, goals="varied", seed=1)
    first = {each.labyrinth.passages: ends(each) for each in shown(tiny.folder, "train")}
    both = [each for each in shown(other.folder, "train") if each.labyrinth.passages in first]
    assert len(both) > 5
    assert any(ends(each) != first[each.labyrinth.passages] for each in both)


# Validation finds what is wrong.


@pytest.mark.parametrize(
    ("splits", "words"),
    [
        ((*SPLITS.sampled, "longer"), "not the labyrinth that its structure gives with this seed"),
        (("recoloured",), "start and goal are not changed as the split says"),
    ],
)
def test_ends_of_another_seed_are_found(folder: Path, splits: Sequence[str], words: str) -> None:
    for split in splits:
        replace_first(folder, split, lambda its: replace(its, start=its.goal, goal=its.start))
    found = problems(folder)
    for split in splits:
        assert f"{first_info_of(split)}{words}" in found


def first_info_of(split: str) -> str:
    """Return how a problem of the first labyrinth of a split begins."""
    return f"{split}-00000-of-00001.parquet row 0 info: "


def test_a_structure_that_no_split_may_have_is_found(folder: Path, navigation: Run) -> None:
    found = [parse(each.text) for each in shown(folder, "train")]
    turned = next(
        replace(its, structure=image)
        for its in found
        for image in its.structure.symmetries()
        if navigation.dataset.bucket_of(image) is None
    )
    replace_first(folder, "train", lambda _: turned)
    assert f"{first_info_of('train')}the structure belongs to no split" in problems(folder)

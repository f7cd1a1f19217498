"""Each shift changes what its name says and nothing else, recomputed from the texts alone."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from statistics import mean

import numpy as np
import pytest
from support.brute_force import Shown, World, fewest_moves, is_connected, loops, shown, walk
from support.making import Run, run_of
from support.tampering import problems, replace_first, rows_of, with_a_wall_opened

from labyrinth_core import load_transitions
from labyrinth_core.data import SPLITS, Dataset, Manifest
from labyrinth_core.language import parse
from labyrinth_core.world import Labyrinth, Look, Solver, Structure, Task
from pipeline.config import ConfigError
from pipeline.generation.labyrinths import toggled, walls
from pipeline.generation.shifts import stretched
from pipeline.generation.structures import sample
from pipeline.inspection import statistics
from pipeline.machinery import console

Build = Callable[..., Run]

OPTIONS = {"size": "5", "labyrinths": 20, "random_steps": 20}


def shifts_of(task: Task) -> tuple[str, ...]:
    """Return the shifts of a task but `longer`, whose search takes long on tasks with tiles."""
    every = run_of(Path("nowhere"), **OPTIONS, task=str(task), shifts=("all",)).dataset.shifts
    return tuple(each for each in every if each != "longer" or not task.rules.tiles)


@pytest.fixture(
    scope="session",
    params=[
        pytest.param(str(task), marks=pytest.mark.slow if task is not Task.NAVIGATION else ())
        for task in Task
    ],
)
def shifted(
    request: pytest.FixtureRequest, build: Build, tmp_path_factory: pytest.TempPathFactory
) -> Run:
    if request.param == "navigation":
        return request.getfixturevalue("plain")
    folder = tmp_path_factory.mktemp(f"shifted-{request.param}")
    return build(folder, **OPTIONS, task=request.param, shifts=shifts_of(Task(request.param)))


@pytest.fixture(scope="session")
def plain(build: Build, tmp_path_factory: pytest.TempPathFactory) -> Run:
    """A dataset of navigation with all shifts."""
    return build(tmp_path_factory.mktemp("plain"), **OPTIONS, shifts=("all",))


@pytest.fixture
def folder(plain: Run, tmp_path: Path) -> Path:
    """A copy of it, to be tampered with."""
    return Path(shutil.copytree(plain.folder, tmp_path / plain.folder.name))


def with_parents(folder: Path, split: str) -> Iterator[tuple[Shown, Shown]]:
    parent = SPLITS[split].parent
    assert parent is not None
    parents = {each.number: each for each in shown(folder, parent)}
    children = shown(folder, split)
    assert children
    assert [each.number for each in children] == sorted({each.number for each in children})
    for child in children:
        yield child, parents[child.number]


# The relations, from the texts alone.


def test_the_splits_of_every_dataset_stay_as_they_are(
    build: Build, plain: Run, tmp_path: Path
) -> None:
    expected = Manifest.read(build(tmp_path, **OPTIONS).folder)
    assert expected.config.splits == SPLITS.base
    found = Manifest.read(plain.folder)
    assert found.shards[: len(expected.shards)] == expected.shards
    assert {shard.split for shard in found.shards} == set(found.config.splits)


@pytest.mark.slow
def test_what_was_built_is_valid(shifted: Run) -> None:
    assert problems(shifted.folder) == []


@pytest.mark.parametrize("split", [s for s in SPLITS if SPLITS[s].new_start or SPLITS[s].new_goal])
def test_start_and_goal_are_changed_as_the_split_says(shifted: Run, split: str) -> None:
    for child, parent in with_parents(shifted.folder, split):
        mine, its = child.labyrinth, parent.labyrinth
        assert mine.passages == its.passages
        assert (mine.start != its.start, mine.goal != its.goal) == (
            SPLITS[split].new_start,
            SPLITS[split].new_goal,
        )
        apart = sum(abs(a - b) for a, b in zip(mine.start, mine.goal, strict=True))
        assert apart >= 5
        assert len(child.actions) == fewest_moves(mine)


def test_one_wall_blocks_the_demonstrated_route_or_opens_a_shorter_one(shifted: Run) -> None:
    for child, parent in with_parents(shifted.folder, "one_wall"):
        mine, its = child.labyrinth, parent.labyrinth
        assert len(mine.passages ^ its.passages) == 1
        assert (replace(mine, passages=its.passages), child.settings) == (its, parent.settings)
        assert is_connected(mine.height, mine.width, mine.passages)
        arrives = walk(mine, parent.actions) == mine.goal
        assert not arrives or fewest_moves(mine) < len(parent.actions)


def test_selected_labyrinths_have_the_property_of_their_shift(shifted: Run) -> None:
    of = {
        split: [each.labyrinth for each in shown(shifted.folder, split)]
        for split in ("train", "open", *({"longer", "trees"} & {*shifted.dataset.shifts}))
    }
    for labyrinth in of.get("longer", ()):
        assert fewest_moves(labyrinth) > max(map(fewest_moves, of["train"]))
    assert not any(map(loops, of.get("trees", ())))
    assert min(map(loops, of["open"])) > max(map(loops, of["train"]))


def test_no_route_of_train_is_a_shortest_one_where_routes_are_new(shifted: Run) -> None:
    routes = [each.actions for each in shown(shifted.folder, "train")]

    def known(labyrinth: World) -> bool:
        return any(
            len(route) == fewest_moves(labyrinth)
            and walk(labyrinth, route) == labyrinth.goal
            and not {walk(labyrinth, route[:steps]) for steps in range(len(route))} & labyrinth.ice
            for route in routes
        )

    assert not any(known(each.labyrinth) for each in shown(shifted.folder, "test_new_routes"))
    assert all(known(each.labyrinth) for each in shown(shifted.folder, "train"))
    if shifted.options.task == "navigation":  # Where the split would else be like any other.
        assert any(known(each.labyrinth) for each in shown(shifted.folder, "test"))


@pytest.mark.parametrize("split", ["recoloured", "thin_walls"])
def test_a_look_changes_pixels_alone(shifted: Run, split: str) -> None:
    pairs = list(with_parents(shifted.folder, split))
    assert len(pairs) == OPTIONS["labyrinths"]
    for child, parent in pairs:
        assert f"look: {split}\n" in child.settings
        assert child.text.replace(f"look: {split}\n", "") == parent.text
        assert child.actions == parent.actions
        assert all(a != b for a, b in zip(child.pictures, parent.pictures, strict=True))


@pytest.mark.parametrize("split", ["trees", "depth_first", "kruskal", "prim", "test_new_routes"])
def test_what_a_shift_leaves_free_follows_test(plain: Run, split: str) -> None:
    def of(split: str) -> list[World]:
        return [each.labyrinth for each in shown(plain.folder, split)]

    pairs = list(zip(of(split), of("test"), strict=True))
    assert mean(fewest_moves(mine) == fewest_moves(its) for mine, its in pairs) >= 0.7
    if split != "trees":
        assert mean(loops(mine) == loops(its) for mine, its in pairs) >= 0.7


# Several shards.


@pytest.mark.slow
def test_several_shards_are_numbered_like_their_parents(build: Build, tmp_path: Path) -> None:
    shifts = ("g", "one_wall", "recoloured")
    run = build(tmp_path, **OPTIONS, shifts=shifts, cells_per_shard=200)
    assert len(Manifest.read(run.folder).of("one_wall")) == 3
    assert problems(run.folder) == []
    list(with_parents(run.folder, "one_wall"))


@pytest.mark.slow
def test_a_shard_whose_parents_have_no_such_variant_is_empty(build: Build, tmp_path: Path) -> None:
    options = {"labyrinths": 11, "random_steps": 5, "shifts": ("one_wall",)}
    run = build(tmp_path, **options, cells_per_shard=10 * 9)
    manifest = Manifest.read(run.folder)
    assert [shard.labyrinths for shard in manifest.of("one_wall")] == [2, 0]
    assert problems(run.folder) == []
    assert (
        statistics.count_dataset(Dataset.at(run.folder, manifest)).splits["one_wall"].labyrinths
        == 2
    )
    loaded = load_transitions(run.data_dir, "3x3", split="one_wall", cache_dir=False)
    assert len(set(loaded.labyrinth_ids)) == 2


@pytest.mark.slow
def test_equal_twins_of_two_labyrinths_of_train_are_one(build: Build, tmp_path: Path) -> None:
    """With this seed the last two of train have the same twin, whose rows would be taken as one."""
    run = build(tmp_path, labyrinths=32, seed=6, random_steps=5, shifts=("one_wall",))
    assert problems(run.folder) == []
    counts = statistics.count_dataset(Dataset.at(run.folder)).splits["one_wall"]
    assert counts.labyrinths == counts.episodes == 9


@pytest.mark.slow
def test_who_learnt_from_some_labyrinths_is_judged_on_those_derived_from_them(
    build: Build, tmp_path: Path
) -> None:
    """With these options `g` lacks labyrinths 10 and 13 of train."""
    options = {"size": "4", "task": "key_and_door", "labyrinths": 20, "shifts": ("g",)}
    data = Dataset.at(build(tmp_path, **options, random_steps=5).folder)

    def structures(split: str) -> list[Structure]:
        return [each.structure for each in data.of_first(split, 19).labyrinths]

    train = structures("train")
    assert structures("s0") == train
    assert len(train) == 19
    assert structures("g") == [each for number, each in enumerate(train) if number not in (10, 13)]


# Validation finds what is wrong.


def says(found: list[str], split: str, words: str) -> bool:
    start = f"{split}-00000-of-00001.parquet row 0 info: "
    return any(problem.startswith(start) and words in problem for problem in found)


def changed_once_more(labyrinth: Labyrinth, _: Path) -> Labyrinth:
    return with_a_wall_opened(labyrinth)


def with_another_goal(labyrinth: Labyrinth, _: Path) -> Labyrinth:
    return replace(labyrinth, goal=labyrinth.goal - 1)


def in_the_corners(labyrinth: Labyrinth, _: Path) -> Labyrinth:
    return replace(labyrinth, start=0, goal=24)


def as_ever(labyrinth: Labyrinth, _: Path) -> Labyrinth:
    return replace(labyrinth, look=Look.PLAIN)


def first_of_test(_: Labyrinth, folder: Path) -> Labyrinth:
    return parse(shown(folder, "test")[0].text)


def first_of_train(_: Labyrinth, folder: Path) -> Labyrinth:
    return parse(shown(folder, "train")[0].text)


def with_the_route_as_good(_: Labyrinth, folder: Path) -> Labyrinth:
    """Return the first parent of `one_wall` with a wall opened that leaves its route shortest."""
    _, parent = next(with_parents(folder, "one_wall"))
    its = parse(parent.text)
    opened = (
        replace(its, structure=toggled(its.structure, *wall)) for wall in walls(its.structure)
    )
    return next(twin for twin in opened if parent.actions in Solver(twin).shortest_routes())


def with_a_known_route(_: Labyrinth, folder: Path) -> Labyrinth:
    routes = [each.actions for each in shown(folder, "train")]
    candidates = (parse(each.text) for each in shown(folder, "test"))
    return next(
        its for its in candidates if any(route in Solver(its).shortest_routes() for route in routes)
    )


MOVED = ("g", "test_s0", "test_g", "test_s0_and_g")
REDRAWN = ("recoloured", "thin_walls")
SELECTED = ("longer", "trees", "open", "depth_first", "kruskal", "prim", "test_new_routes")


Change = Callable[[Labyrinth, Path], Labyrinth]


@pytest.mark.slow
@pytest.mark.parametrize(
    "changes",
    [
        {
            changed_once_more: {
                "one_wall": "2 walls differ from its parent, not one",
                "trees": "it has 1 loops",
                **{
                    split: f"is not that of its parent in {SPLITS[split].parent}"
                    for split in (*MOVED, *REDRAWN)
                },
            }
        },
        {
            with_another_goal: {"one_wall": "its goal is not that"},
            first_of_train: dict.fromkeys(SELECTED, "the structure belongs to train"),
            in_the_corners: dict.fromkeys(MOVED, "not changed as the split says"),
            as_ever: {split: f"its look is plain, not {split}" for split in REDRAWN},
        },
        {
            with_the_route_as_good: {"one_wall": "as short as any"},
            first_of_test: {
                "longer": "and train has one of",
                "open": "and train has a labyrinth with",
            },
            with_a_known_route: {"test_new_routes": "train demonstrates one of its shortest route"},
        },
    ],
    ids=["a wall", "goals, structures and looks", "routes"],
)
def test_a_labyrinth_without_the_property_of_its_shift_is_found(
    folder: Path, changes: dict[Change, dict[str, str]]
) -> None:
    for change, words in changes.items():
        for split in words:
            replace_first(folder, split, lambda its, change=change: change(its, folder))
    found = problems(folder)
    for words in changes.values():
        assert [split for split in words if not says(found, split, words[split])] == []


@pytest.mark.slow
@pytest.mark.parametrize("split", ["g", "one_wall"])
def test_a_labyrinth_that_is_left_out_without_a_reason_is_found(folder: Path, split: str) -> None:
    file = f"{split}-00000-of-00001.parquet"
    with rows_of(folder, file) as rows:
        number = int(rows[0]["obs"]["path"].split("-")[1])
        rows[:] = [row for row in rows if row["info"] != rows[0]["info"]]
    what = f"the labyrinth made from labyrinth {number} of {SPLITS[split].parent} is missing"
    assert f"{file} row 0 info: {what}" in problems(folder)


# What is loaded, and what is refused.


@pytest.mark.slow
def test_every_shift_is_loaded_by_the_loader_and_by_datasets(plain: Run) -> None:
    from datasets import load_dataset

    dataset = load_dataset(str(plain.data_dir), "5x5")
    assert list(dataset) == [*plain.dataset.splits]
    for split in plain.dataset.shifts:
        options = {"split": split, "cache_dir": False}
        decoded = load_transitions(plain.data_dir, "5x5", **options)
        drawn = load_transitions(plain.data_dir, "5x5", **options, draw=True)
        assert np.array_equal(decoded.frames, drawn.frames)
        assert len(decoded) + len(shown(plain.folder, split)) == dataset[split].num_rows


@pytest.mark.slow
@pytest.mark.parametrize(
    ("shift", "labyrinths"), [("longer", 32), ("test_new_routes", 32), ("one_wall", 3)]
)
def test_a_shift_that_cannot_be_found_leaves_nothing(
    build: Build, tmp_path: Path, shift: str, labyrinths: int
) -> None:
    """At 3x3 no route is longer than the longest of 32, and few are new beside theirs; none of the
    first three labyrinths has a twin."""
    with pytest.raises(ConfigError, match=rf"shifts: .*{shift} .*; .* leave {shift} out"):
        build(tmp_path / "d", labyrinths=labyrinths, shifts=(shift,))
    assert not (tmp_path / "d").exists()


def test_a_search_for_the_structures_of_a_shift_shows_a_bar(
    make_run: Callable[..., Run], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The search for `longer` may take minutes."""
    bars = console.Bars(disable=True)
    monkeypatch.setattr(console, "progress", lambda **_: bars)
    sample(make_run(Path("nowhere"), labyrinths=4, shifts=("longer",)).dataset)
    assert [(bar.description, bar.completed, bar.total) for bar in bars.tasks] == [("longer", 4, 4)]


def test_structures_are_stretched_with_as_many_loops_as_before() -> None:
    rng = np.random.default_rng(0)
    grid = next(Structure.sample(4, 4, rng, open_walls=0.3))

    def moves(structure: Structure) -> int:
        return structure.distances(0)[15]

    (longer,) = stretched(iter([grid]), moves, lambda _: True, 9, rng)
    assert moves(grid) <= 9 < moves(longer)
    assert longer.is_connected
    assert longer.loops == grid.loops > 0

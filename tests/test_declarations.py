"""A rule is declared in one place: CONTRIBUTING names it, and everything else reads it.

A new task, look, column, observation or shift is tried here as soon as it is declared.
"""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import fields
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from support.making import Run

import labyrinth_core.env  # noqa: F401
from labyrinth_core import Dataset, load_arrays, load_episodes, load_transitions
from labyrinth_core.data import COLUMNS, SPLITS
from labyrinth_core.language import SETTINGS_OF
from labyrinth_core.pictures import COLOURS_IN_WORDS, DEFAULT_STYLE, OBSERVATIONS, ObservationSpec
from labyrinth_core.world import TILES, Labyrinth, Look, Solver, Task, sample_labyrinth
from labyrinth_core.world.tasks import PLACEMENTS
from pipeline.generation.labyrinths import NEW_STRUCTURES
from pipeline.generation.shard import Fingerprint, render
from pipeline.generation.shifts import SELECTED_SHIFTS

ROOT = Path(__file__).parents[1]


# The table of CONTRIBUTING.

ROWS = "another task|other colours; another look|another column|another observation|another shift"


def places() -> Iterator[tuple[str, Path, str]]:
    """Yield each place that the rows of new rules name: the row, the file, the name in it."""
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    for row in re.findall(rf"^\| (?:{ROWS}) .*", text, re.MULTILINE):
        file, folder = ROOT, ROOT
        for word in re.findall(r"`([^`]+)`", row):
            if "." in word:
                file = ROOT / word if "/" in word else folder / word
                folder = file.parent
            elif " " not in word and file.suffix == ".py":
                yield row[2:].partition(" |")[0], file, word


def names_in(path: Path) -> set[str]:
    """Return what a module defines: functions, classes, their fields, and variables."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            found.add(node.name)
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            found.add(node.id)
    return found


def test_contributing_says_where_each_new_rule_is_declared() -> None:
    assert {row for row, _, _ in places()} == {*ROWS.split("|")}
    for row, path, name in places():
        assert name in names_in(path), f"{path.name} has no {name}, for {row}"


# A task, a look.


def test_every_tile_has_a_letter_a_colour_and_words_in_every_look() -> None:
    own = {each.name: each.default for each in fields(Labyrinth)}
    colours = {each.name for each in fields(DEFAULT_STYLE)}
    assert COLOURS_IN_WORDS.keys() == {*Look}
    for tile in TILES:
        assert own[tile.name] == (frozenset() if tile.many else None)
        assert tile.name in colours
        assert all(tile.name in words for words in COLOURS_IN_WORDS.values())
    letters = ["S", "E", *(tile.letter for tile in TILES)]
    assert len({*letters}) == len(letters) == len("".join(letters))
    assert not {*letters} & {*" @?.|-+"}


@pytest.mark.parametrize("task", Task)
def test_a_task_says_what_it_needs_and_how_it_is_placed(task: Task) -> None:
    rules = task.rules
    assert bool(rules.tiles) == bool(rules.owned) == bool(rules.question) == (task in PLACEMENTS)
    assert (": True\n" in SETTINGS_OF[task]) == (task is not Task.NAVIGATION)
    language = (ROOT / "docs" / "language.md").read_text(encoding="utf-8")
    assert f"`{rules.setting}`" in language or not rules.setting
    assert all(f"`{tile.letter}`" in language for tile in rules.tiles)


# A column.


@pytest.mark.parametrize(
    "place", range(len(COLUMNS.numbers)), ids=[each.name for each in COLUMNS.numbers]
)
def test_a_column_of_numbers_is_in_the_fingerprint(place: int) -> None:
    rng = np.random.default_rng(0)
    labyrinth = sample_labyrinth(3, 3, Task.NAVIGATION, rng)
    episode = labyrinth.replay(Solver(labyrinth).shortest_route(rng))
    rows = [row for part in render("train", 0, "", [episode]) for row in part]
    numbers = list(rows[1].numbers)
    numbers[place] = (
        not numbers[place] if COLUMNS.numbers[place].type == "bool" else numbers[place] + 1
    )
    found = set()
    for some in (rows, [rows[0], rows[1]._replace(numbers=tuple(numbers)), *rows[2:]]):
        fingerprint = Fingerprint()
        fingerprint.update(some)
        found.add(fingerprint.hexdigest())
    assert len(found) == 2


def test_a_column_of_numbers_is_loaded(small_dataset: Run) -> None:
    loaded = load_transitions(small_dataset.data_dir, "3x3", observation="vector")
    episodes = list(load_episodes(small_dataset.data_dir, "3x3", observation="vector"))
    named = {"actions", "rewards", "episode_starts"}
    for column in (each for each in COLUMNS.numbers if each.name not in named):
        states = [each.columns[column.name] for each in episodes]
        assert [len(each) for each in states] == [len(each) + 1 for each in episodes]
        acting = np.concatenate([each[:-1] for each in states])
        assert np.array_equal(loaded.columns[column.name], acting)
    assert {column.name for column in COLUMNS} - {column.name for column in COLUMNS.numbers} == {
        "obs",
        "info",
    }


WITH_A_COLUMN = """
import sys
from labyrinth_core.data import format
from labyrinth_core.world.solver import Solver

def left(episode):
    to_goal = Solver(episode.labyrinth).distances
    return [to_goal[episode.labyrinth.state_index(state)] for state in episode.states]

[column] = format.Columns.of(("least_moves", "int32", "least moves to the goal", left))
*others, info = format.COLUMNS
format.COLUMNS = format.Columns((*others, column, info))
format.OTHERS = (column,)

from labyrinth_core import Dataset, load_episodes, load_transitions, stream_episodes
from pipeline.__main__ import main

folder = sys.argv.pop()
sys.argv += ["size=3", "labyrinths=4", "workers=1", f"data_dir={folder}"]
sys.argv += ["stages=[build,validate]"]
try:
    main()
except SystemExit as end:
    assert not end.code
for options in ({"observation": "vector"}, {"image_size": 8, "cache_dir": f"{folder}/cache"}):
    train = load_transitions(folder, "3x3", **options)
    left = train.columns["least_moves"]
    assert left.dtype == "int32" and (left[train.terminated] == 1).all()
    assert (left[:-1] - left[1:] == 1)[~train.dones[:-1]].all()
for episodes in (load_episodes, stream_episodes):
    for episode in episodes(folder, "3x3", observation="vector"):
        to_goal = episode.columns["least_moves"]
        assert len(to_goal) == len(episode) + 1 and to_goal[-1] == 0
print(Dataset(folder, "3x3").fingerprint)
"""


@pytest.mark.slow  # A process of its own, since modules read the columns when they are imported.
def test_a_new_column_is_written_checked_hashed_and_loaded(
    tmp_path: Path, build: Callable[..., Run]
) -> None:
    command = [sys.executable, "-c", WITH_A_COLUMN, str(tmp_path / "with")]
    run = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert run.returncode == 0, run.stderr
    without = build(tmp_path / "without", labyrinths=4, random_steps=100)
    assert "is valid" in run.stdout
    assert run.stdout.splitlines()[-1] != Dataset(without.data_dir, "3x3").fingerprint


# An observation.


@pytest.mark.parametrize("kind", [kind for kind in OBSERVATIONS if kind != "image"])
def test_an_observation_is_loaded_and_evaluated_alike(small_dataset: Run, kind: str) -> None:
    place = small_dataset.data_dir, "3x3"
    loaded = load_transitions(*place, observation=kind)
    arrays = load_arrays(*place, "train", observation=kind)
    assert len(arrays.observations) >= len(arrays.labyrinths)
    first = np.flatnonzero(np.diff(loaded.labyrinth_ids, prepend=-1))
    assert np.array_equal(loaded.observations[first], arrays.observations[arrays.initial])


@pytest.mark.parametrize(
    "kind", ["state", *(kind for kind in OBSERVATIONS if ObservationSpec(kind).is_bounded)]
)
def test_an_observation_is_that_of_one_environment_and_of_many(kind: str) -> None:
    name = "labyrinth_core.env:Labyrinth-v0"
    one = gymnasium.make(name, size=3, task="icy_floor", observation=kind)
    many = gymnasium.make_vec(name, num_envs=2, size=3, task="icy_floor", observation=kind)
    seen, _ = one.reset(seed=3)
    both, _ = many.reset(seed=3)
    for action in (0, 1):
        assert one.observation_space.contains(seen)
        assert np.array_equal(seen, both[0])
        seen, *_ = one.step(action)
        both, *_ = many.step(np.array([action, action]))


def test_the_page_on_the_environment_explains_every_observation() -> None:
    page = (ROOT / "docs" / "environment.md").read_text("utf-8")
    assert all(f'**`"{kind}"`**' in page for kind in (*OBSERVATIONS, "state"))


# A shift.


def test_a_shift_says_how_its_structures_are_made() -> None:
    own = {name for name in SPLITS.shifts if SPLITS[name].parent is None}
    assert own == SELECTED_SHIFTS.keys()
    assert {name for name, split in SPLITS.items() if split.new_structure} == NEW_STRUCTURES.keys()
    numbers = [split.number for split in SPLITS.values()]
    assert sorted({*numbers}) == sorted(numbers)
    page = (ROOT / "docs" / "shifts.md").read_text("utf-8")
    assert all(f"`{name}`" in page for name in SPLITS.shifts)

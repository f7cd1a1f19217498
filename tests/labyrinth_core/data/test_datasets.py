"""`Dataset` and `Selection`: each method gives what the function of before gives."""

from __future__ import annotations

import pickle
import shutil
from collections.abc import Callable, Iterable
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
import pytest
from support.making import Run

from labyrinth_core import (
    Dataset,
    DatasetError,
    Labyrinth,
    Selection,
    compare,
    evaluate,
    hub,
    load_arrays,
    load_episodes,
    load_transitions,
    stream_episodes,
    stream_transitions,
)
from labyrinth_core.data import Manifest
from labyrinth_core.notebooks import WIDTH, register

LONG = pc.field("moves") >= 5
PARTS: list[dict[str, Any]] = [{}, {"labyrinths": 2}, {"where": LONG, "labyrinths": 3}]
VECTOR: dict[str, Any] = {"observation": "vector"}


@pytest.fixture(scope="module")
def data_dir(build: Callable[..., Run], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A dataset of eight labyrinths a split, in two shards each, and of several routes in each."""
    options = {"size": "3x4", "labyrinths": 8, "solutions": "all", "random_steps": 40}
    return build(tmp_path_factory.mktemp("data"), cells_per_shard=48, **options).data_dir


@pytest.fixture(autouse=True)
def cache_of_its_own(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))


@pytest.fixture
def data(data_dir: Path) -> Dataset:
    return Dataset(data_dir, "3x4")


def values(item: Any) -> Any:
    """Return what an episode, or transitions, consist of, to be compared."""
    fields = vars(item) if hasattr(item, "__dict__") else item._asdict()
    columns = fields.get("columns", {})
    return {
        name: value.tobytes() if isinstance(value, np.ndarray) else value
        for name, value in {**fields, **columns, "columns": set(columns)}.items()
    }


def all_values(items: Iterable[Any]) -> list[Any]:
    return [values(item) for item in items]


# The same as the functions.


@pytest.mark.parametrize("split", ["train", "random"])
@pytest.mark.parametrize("some", PARTS, ids=str)
@pytest.mark.parametrize("shown", [VECTOR, {"image_size": 8, "draw": True}], ids=str)
def test_each_method_gives_what_the_function_gives(
    data_dir: Path, data: Dataset, split: str, some: dict[str, Any], shown: dict[str, Any]
) -> None:
    chosen = data[split].filter(some.get("where"), labyrinths=some.get("labyrinths"))
    same = {"source": data_dir, "config": "3x4", "split": split, **some, **shown}
    found = chosen.transitions(**shown, optimal=True)
    assert values(found) == values(load_transitions(**same, optimal=True))
    episodes = all_values(load_episodes(**same))
    assert all_values(chosen.iterate_episodes(**shown)) == episodes
    order = {"shuffle": 5, "seed": 2, "rank": 1, "world_size": 2}
    assert all_values(chosen.stream(**shown, **order)) == all_values(
        stream_transitions(**same, **order)
    )
    assert all_values(chosen.stream_episodes(**shown, **order)) == all_values(
        stream_episodes(**same, **order)
    )
    state = stream_transitions(**same).state_dict()
    assert chosen.stream(**shown).state_dict() == state
    assert (chosen.total_episodes, chosen.total_steps) == (len(episodes), len(found))
    if not some or split == "train":
        arrays = load_arrays(data_dir, "3x4", split, observation="vector", **some)
        assert chosen.labyrinths == arrays.labyrinths


def test_a_policy_is_judged_on_a_dataset_as_on_its_folder(data_dir: Path, data: Dataset) -> None:
    def right(observations: Any) -> Any:
        return np.full(len(observations), 1)

    assert evaluate(right, data).splits.keys() == {*data.splits} - {"random"}
    found, same = (evaluate(right, *given, **VECTOR) for given in ((data,), (data_dir, "3x4")))
    assert repr(found) == repr(same)
    assert (found.dataset, found.fingerprint) == (same.dataset, same.fingerprint)
    compared = [compare(right, right, *given, most=64) for given in ((data,), (data_dir, "3x4"))]
    assert compared[0] == compared[1]
    assert repr(compared[0]) == str(compared[0])
    assert repr(compared[0]).startswith("not decided, after 64 labyrinths")
    for given, message in (
        ({"config": "3x4"}, "config='3x4': leave it out, the Dataset has its own"),
        ({"revision": "1.0.0"}, "revision='1.0.0': leave it out, the Dataset has its own"),
    ):
        for call in (evaluate, lambda *args, **how: compare(right, *args, **how)):
            with pytest.raises(ValueError, match=message):
                call(right, data, **given)  # type: ignore[operator]
    with pytest.raises(ValueError, match="config=None: give a name, such as '5x5'"):
        evaluate(right, data_dir)


# What a dataset and its splits say of themselves.


def test_a_dataset_has_its_splits_its_fingerprint_and_its_table(
    data_dir: Path, data: Dataset
) -> None:
    manifest = Manifest.read(data_dir / "3x4")
    assert data.splits == ("train", "validation", "test", "random", "s0", "s0_and_g")
    assert [*data] == [*data.splits]
    assert "train" in data
    assert "tests" not in data
    assert data.fingerprint == manifest.fingerprint
    assert data.table == pq.read_table(data_dir / "3x4" / Manifest.TABLE)
    lines = repr(data).splitlines()
    assert lines[0] == f"Dataset 3x4 of {data_dir}"
    assert lines[1] == "  labyrinths: 3 x 4, navigation"
    assert lines[2].startswith("  splits: train 8, validation 8, test 8, random 8, s0 8, ")
    assert lines[4:] == [f"  fingerprint: {data.fingerprint}"]
    steps = sum(data[split].total_steps for split in data)
    episodes = sum(data[split].total_episodes for split in data)
    assert lines[3] == f"  episodes: {episodes:,} of {steps:,} steps"


def test_a_selection_says_what_it_is_in_five_lines(data_dir: Path, data: Dataset) -> None:
    some = data["test"].filter(LONG).filter(labyrinths=2)
    assert repr(some).splitlines() == [
        f"Selection test in 3x4 of {data_dir}",
        "  labyrinths: 2 of 8",
        "  filter: (moves >= 5), then the first 2",
        f"  episodes: {some.total_episodes}",
        f"  steps: {some.total_steps}",
    ]
    assert "  labyrinths: 8\n  filter: none\n" in repr(data["test"])


def test_a_selection_has_no_length_but_is_true(data: Dataset) -> None:
    with pytest.raises(TypeError, match="use total_episodes or total_steps"):
        len(data["train"])
    assert data["train"]


def test_what_a_split_holds_is_in_its_spaces(data: Dataset) -> None:
    train = data["train"]
    found = train.transitions()
    assert found.frames[0] in train.observation_space
    assert set(found.actions.tolist()) <= set(range(4))
    assert all(action in train.action_space for action in found.actions)


# Filters.


def test_filters_follow_one_another(data: Dataset) -> None:
    train = data["train"]
    short = pc.field("moves") < 7
    assert train.filter() is train
    assert train.filter(LONG).filter(short).labyrinths == train.filter(LONG & short).labyrinths
    first = train.filter(labyrinths=5)
    assert first.labyrinths == train.labyrinths[:5]
    expected = [each for each in first.labyrinths if each in train.filter(LONG).labyrinths]
    assert first.filter(LONG).labyrinths == tuple(expected)
    assert first.filter(LONG) is not first
    assert first.filter(labyrinths=5).total_steps == first.total_steps


@pytest.mark.parametrize(
    ("where", "labyrinths", "message"),
    [
        (pc.field("lenght") > 3, None, r"where=\(lenght > 3\): No match .* labyrinth_id, "),
        ("moves > 3", None, "where='moves > 3': give an expression, such as "),
        (pc.field("moves") > 99, None, "where=.*: the selection has no such labyrinth$"),
        (None, 5, "labyrinths=5: give a whole number from 1 to 4, as many as the selection has$"),
        (None, 0, "labyrinths=0: give a whole number from 1 to 4, "),
    ],
)
def test_a_wrong_filter_is_refused_at_once(
    data: Dataset, where: Any, labyrinths: Any, message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        data["train"].filter(labyrinths=4).filter(where, labyrinths=labyrinths)


# Samples.


@pytest.mark.parametrize("some", PARTS, ids=str)
def test_sampled_episodes_are_episodes_of_the_selection_each_once(
    data: Dataset, some: dict[str, Any]
) -> None:
    chosen = data["train"].filter(some.get("where"), labyrinths=some.get("labyrinths"))
    every = all_values(chosen.iterate_episodes(**VECTOR))
    for seed in range(3):
        for n in (1, 2, len(every)):
            found = all_values(chosen.sample_episodes(n, seed=seed, **VECTOR))
            places = [every.index(each) for each in found]
            assert len({*places}) == len(places) == n
            assert all_values(chosen.sample_episodes(n, seed=seed, **VECTOR)) == found
    orders = {
        tuple(every.index(each) for each in all_values(drawn))
        for drawn in (chosen.sample_episodes(2, seed=seed, **VECTOR) for seed in range(9))
    }
    assert len(orders) > 1


@pytest.mark.parametrize("n", [0, -1, True, 2.5, "3", 10**9])
def test_another_number_of_episodes_than_there_are_is_refused(data: Dataset, n: Any) -> None:
    most = data["train"].total_episodes
    with pytest.raises(ValueError, match=f"n=.*: give a whole number from 1 to {most}, as many as"):
        data["train"].sample_episodes(n)


@pytest.mark.parametrize("episodes", [None, 0, 2**31 - 1])
def test_a_table_with_impossible_numbers_of_episodes_is_refused(
    data_dir: Path, tmp_path: Path, episodes: int | None
) -> None:
    folder = Path(shutil.copytree(data_dir, tmp_path / "copy")) / "3x4"
    table = pq.read_table(folder / Manifest.TABLE)
    place = table.column_names.index("episodes")
    column = pa.array([episodes] * len(table), table.schema.field(place).type)
    pq.write_table(
        table.set_column(place, table.schema.field(place), column), folder / Manifest.TABLE
    )
    Manifest.read(folder).with_table(folder / Manifest.TABLE).write(folder)
    with pytest.raises(DatasetError, match="does not match the shards of split=train"):
        Dataset(folder.parent, "3x4")["train"].sample_episodes(1)


# Environments.


def test_a_recovered_environment_goes_through_the_labyrinths_of_the_selection(
    data: Dataset,
) -> None:
    some = data["test"].filter(labyrinths=3)
    env = some.recover_environment(render_mode="rgb_array", observation="vector")
    met: list[Labyrinth] = []
    for _ in range(4):
        observation, _ = env.reset()
        assert observation in env.observation_space
        met.append(env.labyrinth)
    assert tuple(met) == (*some.labyrinths, some.labyrinths[0])
    env.reset(seed=8)
    assert env.labyrinth == some.labyrinths[2]
    picture = env.render()
    assert isinstance(picture, np.ndarray)
    assert picture.shape == (600, 600, 3)


# Errors, and changes while a dataset is held.


@pytest.mark.parametrize("split", ["tests", 0, None])
def test_another_split_is_refused_at_once(data: Dataset, split: Any) -> None:
    with pytest.raises(DatasetError, match=f"split={split}: the dataset has train, validation, "):
        data[split]


def test_another_dataset_is_refused_at_once(data_dir: Path) -> None:
    with pytest.raises(DatasetError, match=r"config=5x5: .* holds 3x4"):
        Dataset(data_dir, "5x5")
    with pytest.raises(ValueError, match=r"revision=v1: .* is a folder, which has no revisions"):
        Dataset(data_dir, "3x4", "v1")


def test_a_dataset_stays_that_of_its_manifest(build: Callable[..., Run], tmp_path: Path) -> None:
    folder = build(tmp_path / "data", labyrinths=3).data_dir
    data = Dataset(folder, "3x3")
    some = data["train"].filter(labyrinths=2)
    build(folder, labyrinths=3, seed=1, overwrite=True)
    again = "3x3 was replaced or grew while it was read: run this again"
    reads: list[Callable[[], object]] = [
        lambda: data["train"].transitions(**VECTOR),
        lambda: next(some.iterate_episodes(**VECTOR)),
        lambda: next(data["train"].stream(**VECTOR)),
        lambda: data.table,
        lambda: data["train"].labyrinths,
    ]
    for read in reads:
        with pytest.raises(DatasetError, match=again):
            read()
    assert Dataset(folder, "3x3")["train"].total_episodes > 0


def test_all_of_a_dataset_on_the_hub_is_of_one_commit(
    data_dir: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    commit = "0123456789abcdef0123456789abcdef01234567"
    shutil.copytree(data_dir, tmp_path / commit)
    commits, asked = iter([commit, commit]), []

    def download(_repo_id: str, _repo_type: str, of: str, names: list[str]) -> Path:
        asked.append((of, [name.removeprefix("3x4/") for name in names]))
        return tmp_path / of

    monkeypatch.setattr(hub, "commit_of", lambda *_: next(commits))  # Asked once a dataset.
    monkeypatch.setattr(hub, "download", download)
    data = Dataset("user/labyrinth", "3x4")
    assert asked == [(commit, [Manifest.FILE])]
    found = data["train"].transitions(**VECTOR)
    assert values(found) == values(load_transitions(data_dir, "3x4", **VECTOR))
    shards = [shard.path for shard in data.manifest.of("train")]
    assert asked[1:] == [(commit, [Manifest.FILE]), (commit, shards)]
    data["test"].filter(labyrinths=1).transitions(**VECTOR)
    assert {revision for revision, _ in asked} == {commit}
    assert repr(data).startswith("Dataset 3x4 of user/labyrinth\n")
    assert repr(Dataset("user/labyrinth", "3x4", "v1")).startswith(
        "Dataset 3x4 of user/labyrinth@v1\n"
    )


def test_a_dataset_and_its_selections_are_pickled(data: Dataset) -> None:
    some = data["train"].filter(LONG)
    again: Selection = pickle.loads(pickle.dumps(some))
    assert repr(again) == repr(some)
    begun = all_values(islice(some.stream(**VECTOR), 3))
    assert all_values(islice(again.stream(**VECTOR), 3)) == begun


# Notebooks.


def test_an_episode_is_shown_in_one_line(data: Dataset) -> None:
    (episode,) = data["test"].sample_episodes(1, image_size=8)
    steps = len(episode)
    number = f"{episode.labyrinth_id:016x}"
    shape = (steps + 1, 8, 8, 3)
    assert repr([episode]) == (
        f"[LoadedEpisode({steps} steps in {number}, terminated; observations {shape} uint8)]"
    )


def test_a_notebook_shows_the_picture_of_a_labyrinth(data: Dataset) -> None:
    shown: dict[tuple[str, str], Any] = {}

    class Formatter:
        def for_type_by_name(self, module: str, name: str, show: Any) -> None:
            shown[module, name] = show

    class Shell:
        display_formatter = type("Formatters", (), {"formatters": {"image/png": Formatter()}})

    register(None)
    register(Shell)
    labyrinth = data["test"].filter(labyrinths=1).labyrinths[0]
    (show,) = shown.values()
    assert [*shown] == [(type(labyrinth).__module__, type(labyrinth).__name__)]
    png, size = show(labyrinth)
    assert png.startswith(b"\x89PNG")
    assert size == {"width": WIDTH}

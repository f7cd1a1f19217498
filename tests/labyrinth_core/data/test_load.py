"""A dataset read back: episodes and transitions against a replay of what the files hold."""

import json
import re
import shutil
import socket
import subprocess
import sys
from collections import Counter
from inspect import signature
from itertools import islice

import huggingface_hub
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from datasets import load_dataset
from support.tampering import episode_rows, put_shards

from labyrinth_core import (
    hub,
    load_arrays,
    load_episodes,
    load_transitions,
    stream_episodes,
    stream_transitions,
)
from labyrinth_core.data import COLUMNS, SPLITS
from labyrinth_core.errors import DatasetError
from labyrinth_core.pictures.png import encode
from labyrinth_core.world import Solver, Task, sample_labyrinth

CONFIGS = "3x3", "4x4-key_and_door"


LOADS = pytest.mark.parametrize(
    "load", [load_transitions, load_episodes, stream_episodes, stream_transitions]
)


@pytest.fixture(scope="module")
def data_dir(build, tmp_path_factory):
    """A folder with two datasets, three labyrinths a split, in two or three shards."""
    folder = tmp_path_factory.mktemp("data") / "labyrinth"
    for name in CONFIGS:
        size, _, task = name.partition("-")
        own = {"size": size, "task": task or "navigation", "labyrinths": 3, "random_steps": 70}
        build(folder, cells_per_shard=24, **own)
    return folder


@pytest.fixture(autouse=True)
def cache_of_its_own(monkeypatch, tmp_path):
    """Each test makes the pictures it loads, since it may be about what making them says."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))


@pytest.fixture
def no_network(monkeypatch):
    def refuse(*to, **how):
        raise AssertionError(f"connects: {to} {how}")

    monkeypatch.setattr(socket, "getaddrinfo", refuse)
    monkeypatch.setattr(socket.socket, "connect", refuse)


@LOADS
def test_loaders_and_streams_have_the_arguments_of_load_episodes_in_common(load):
    arguments = signature(load).parameters
    for name, argument in signature(load_episodes).parameters.items():
        assert arguments[name] == argument
    if load is stream_transitions:
        assert arguments == signature(stream_episodes).parameters


def shards_of(data_dir, config, split):
    return sorted((data_dir / config).glob(f"{split}-*.parquet"))


def assert_same_episodes(some, others):
    some, others = list(some), list(others)
    assert len(some) == len(others) > 0
    for one, other in zip(some, others, strict=True):
        for field in ("observations", "actions", "rewards"):
            assert getattr(one, field).dtype == getattr(other, field).dtype
            np.testing.assert_array_equal(getattr(one, field), getattr(other, field))
        for field in ("labyrinth_id", "info", "terminated"):
            assert getattr(one, field) == getattr(other, field)


# What is loaded.


def test_shapes_and_types_are_as_documented(data_dir):
    images = load_transitions(data_dir, "3x3")
    count = len(images)
    for array in (images.observations, images.next_observations):
        assert (array.shape, array.dtype) == ((count, 64, 64, 3), np.uint8)
    vectors = load_transitions(data_dir, "4x4-key_and_door", observation="vector")
    assert vectors.observations.shape == (len(vectors), 5 + 7 * 7)
    assert vectors.observations.dtype == np.int32
    types = {"actions": np.int64, "rewards": np.float32, "labyrinth_ids": np.int64}
    types |= dict.fromkeys(("terminated", "truncated", "dones"), np.bool_)
    for field, kind in (types | {"episode_indices": np.int64}).items():
        assert getattr(images, field).shape == (count,)
        assert getattr(images, field).dtype == kind
    assert len(list(images)) == count
    assert type(images[0].action) is int
    assert str(images).startswith(f"Transitions({count} of ")
    assert str(images).endswith(" labyrinths; observations (64, 64, 3) uint8)")


# Streams.


def divided(data_dir, folder):
    """Return a copy of the datasets, random of 3x3 in files of 50 rows and row groups of 7."""
    shutil.copytree(data_dir, folder)
    table = pa.concat_tables([pq.read_table(path) for path in shards_of(folder, "3x3", "random")])
    tables = [table.slice(first, 50) for first in range(0, len(table), 50)]
    put_shards(folder / "3x3", "random", tables, lambda each: range(0, len(each), 7))
    return folder


@pytest.mark.slow
def test_files_and_row_groups_may_end_in_the_middle_of_an_episode(data_dir, tmp_path):
    other = divided(data_dir, tmp_path / "divided")
    options = {"split": "random", "image_size": 16}
    expected = list(load_episodes(data_dir, "3x3", **options))
    assert_same_episodes(load_episodes(other, "3x3", **options), expected)


@pytest.fixture(scope="module")
def long_episodes(build, tmp_path_factory):
    """A dataset with episodes of 4,000 moves, which are cut between row groups of 64 MiB."""
    options = {"size": "100x100", "sampler": "depth_first", "labyrinths": 2, "random_steps": 4000}
    return build(tmp_path_factory.mktemp("long"), **options).data_dir


@pytest.mark.slow
@pytest.mark.parametrize("shuffle", [False, True, 1000])
def test_episodes_that_leave_their_row_group_are_streamed_once_and_resumed(long_episodes, shuffle):
    (path,) = shards_of(long_episodes, "100x100", "random")
    with pq.ParquetFile(path) as file:
        groups = [file.read_row_group(n, ["actions"]) for n in range(file.num_row_groups)]
    assert any(group["actions"][-1].as_py() != -1 for group in groups)

    def stream(rank):
        shared = {"shuffle": shuffle, "rank": rank, "world_size": 2}
        return stream_transitions(long_episodes, "100x100", **options, **shared)

    def keys(steps):
        return [(s.tobytes(), action, s_next.tobytes()) for s, action, s_next in steps]

    options, met = {"split": "random", "image_size": 8}, Counter()
    for rank in range(2):
        whole, begun, resumed = keys(stream(rank)), stream(rank), stream(rank)
        first = keys(islice(begun, len(whole) // 3))
        resumed.load_state_dict(begun.state_dict())
        assert first + keys(resumed) == whole
        met.update(whole)
    loaded = load_transitions(long_episodes, "100x100", cache_dir=False, **options)
    assert met == Counter(keys(loaded))


def test_a_file_that_another_build_left_is_read_in_no_way(small_dataset, tmp_path):
    folder = shutil.copytree(small_dataset.data_dir, tmp_path / "with_a_stray")
    expected = list(load_episodes(folder, "3x3", image_size=8))
    (path,) = shards_of(folder, "3x3", "train")
    shutil.copy(path, path.with_name("train-00001-of-00002.parquet"))
    for load in (load_episodes, stream_episodes):
        assert_same_episodes(load(folder, "3x3", image_size=8), expected)
    loaded = load_dataset(str(folder), "3x3", split="train", cache_dir=str(tmp_path / "cache"))
    assert sum(loaded["episode_starts"]) == len(expected)


# With a DataLoader.


@pytest.mark.slow
def test_a_data_loader_with_two_workers_streams_each_transition_once(data_dir):
    program = f"""
import json
from torch.utils.data import DataLoader
from labyrinth_core import stream_transitions

def met(workers, **options):
    stream = stream_transitions({str(data_dir)!r}, "3x3", image_size=8, shuffle=40)
    loader = DataLoader(stream, batch_size=3, num_workers=workers, **options)
    epochs = []
    for epoch in range(2):
        stream.set_epoch(epoch)
        epochs.append([step for batch in loader for step in zip(*(a.tolist() for a in batch))])
    assert epochs[0] != epochs[1]
    return [sorted(epoch) for epoch in epochs]

print(json.dumps(
    met(0)
    + met(2)
    + met(2, persistent_workers=True)
    + met(1, persistent_workers=True, multiprocessing_context="spawn")
))
"""
    command = [sys.executable, "-c", program]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    alone, *others = json.loads(done.stdout)
    assert len(alone) == len(load_transitions(data_dir, "3x3", cache_dir=False))
    assert others == [alone] * 7


def test_loading_does_not_import_pandas_which_would_take_most_of_the_time(data_dir, tmp_path):
    program = (
        "import sys; from labyrinth_core import load_transitions\n"
        "load_transitions(sys.argv[1], '3x3', cache_dir=sys.argv[2])\n"
        "assert {'pandas'}.isdisjoint(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", program, data_dir, tmp_path], check=True)


@LOADS
@pytest.mark.parametrize("config", [3, None])
def test_a_config_that_is_no_text_is_refused(load, small_dataset, config):
    message = rf"\Aconfig={config}: give a name, such as '5x5'\Z"
    with pytest.raises(ValueError, match=message):
        load(small_dataset.data_dir, config)


# The Hub.


@LOADS
def test_a_hub_that_cannot_be_reached_gives_one_line(load, tmp_path, monkeypatch):
    monkeypatch.setattr(huggingface_hub.constants, "HF_HUB_OFFLINE", True)
    monkeypatch.setattr(huggingface_hub.constants, "HF_HUB_CACHE", str(tmp_path))
    message = r"nobody/labyrinth is neither a folder \(labyrinth-datasets makes one\) nor .+"
    with pytest.raises(DatasetError, match=rf"\A{message}\Z"):
        load("nobody/labyrinth", "3x3")


@pytest.mark.parametrize(
    "source", ["a/b/c", "../x", "./x", "x/..", "/nowhere/at/all", "labyrinth", "a--b/c", "a/b..c"]
)
@pytest.mark.usefixtures("no_network")
def test_what_is_neither_a_folder_nor_an_id_is_refused_here(source, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(DatasetError) as refusal:
        load_transitions(source, "3x3")
    assert str(refusal.value) == f"{source} is neither a folder nor an id such as user/labyrinth"


@pytest.mark.usefixtures("no_network")
def test_an_id_that_the_hub_forbids_is_refused_here():
    with pytest.raises(DatasetError, match=r"\Auser/labyrinth\. is neither .*alphanumeric.+\Z"):
        load_transitions("user/labyrinth.", "3x3")


# Errors of a user.


@LOADS
@pytest.mark.parametrize(
    ("inner", "options", "message"),
    [
        (".", {"config": "9x9"}, f"config=9x9: .* holds {', '.join(CONFIGS)}"),
        ("3x3", {}, "{0}/3x3 is the folder of the config 3x3: give the folder that holds it, {0}"),
        ("empty", {}, r"config=3x3: .* holds no dataset: it has no manifest\.json, which .*"),
        (".", {"split": "eval"}, f"split=eval: the dataset has {', '.join(SPLITS.base)}"),
    ],
)
def test_what_is_not_there_is_told_what_there_is(data_dir, load, inner, options, message):
    (data_dir / "empty").mkdir(exist_ok=True)
    with pytest.raises(DatasetError, match=rf"\A{message.format(data_dir)}\Z"):
        load(data_dir / inner, **{"config": "3x3"} | options)


def test_a_card_that_is_no_yaml_is_none_of_the_loaders_business(data_dir, tmp_path):
    folder = shutil.copytree(data_dir, tmp_path / "labyrinth")
    (folder / "README.md").write_text("---\nconfigs: [a: b: c\n---\n", encoding="utf-8")
    assert next(stream_episodes(folder, "3x3"))  # Which follows the manifest.


@pytest.mark.parametrize(
    ("there", "holds"),
    [
        (["3x3/manifest.json", "5x5/manifest.json", "old/6x6/manifest.json"], "3x3, 5x5"),
        (["9x9/train-00000-of-00001.parquet"], r"no data.* manifest\.json, which `push_to_hub` .*"),
    ],
)
def test_an_unknown_config_on_the_hub_is_told_which_there_are(tmp_path, monkeypatch, there, holds):
    files = ["README.md", *there]
    monkeypatch.setattr(hub, "commit_of", lambda *_: "0" * 40)
    monkeypatch.setattr(hub, "download", lambda *_: tmp_path)
    monkeypatch.setattr(huggingface_hub.HfApi, "list_repo_files", lambda *_, **__: files)
    with pytest.raises(DatasetError, match=rf"\Aconfig=9x9: user/labyrinth holds {holds}\Z"):
        load_transitions("user/labyrinth", "9x9")


@LOADS
@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"observation": "picture"}, "observation=picture: choose one of image, vector.*"),
        *(
            ({"image_size": size}, f"image_size={size!r}: give a whole number from .*")
            for size in (0, 1.5, "64", 601)
        ),
        ({"revision": "main"}, "revision=main: .* is a folder, which has no revisions"),
    ],
)
def test_an_impossible_argument_is_refused_at_once(data_dir, load, options, message):
    with pytest.raises(ValueError, match=rf"\A{message}\Z"):
        load(data_dir, "3x3", **options)


@pytest.mark.parametrize("cache_dir", ["", " ", 5])
def test_a_cache_that_is_no_folder_is_refused(data_dir, cache_dir):
    with pytest.raises(ValueError, match=rf"\Acache_dir={cache_dir!r}: give a folder, True or"):
        load_transitions(data_dir, "3x3", cache_dir=cache_dir)


# Damaged datasets.


def test_a_shard_with_more_rows_than_the_manifest_says_is_not_read(data_dir, tmp_path, monkeypatch):
    other = divided(data_dir, tmp_path / "divided")
    path = other / "3x3" / "manifest.json"
    path.write_text(path.read_text().replace('"rows": 50', '"rows": 49'))
    monkeypatch.delattr(pq.ParquetFile, "iter_batches")
    with pytest.raises(DatasetError, match="is damaged: rows 50, but the manifest says 49"):
        list(load_episodes(other, "3x3", split="random"))


@pytest.mark.parametrize(
    ("count", "message"),
    [(131_072, "every row needs"), (131_073, "a row group has 131073 rows, more than 131072")],
)
def test_a_row_group_larger_than_any_of_ours_is_not_read(data_dir, tmp_path, count, message):
    schema = COLUMNS.arrow_schema()
    columns = {field.name: pa.nulls(count, field.type) for field in schema}
    # The file is no smaller than one of so many rows could be.
    columns["rewards"] = pa.array(np.random.default_rng(0).random(count, np.float32))
    table = pa.table(columns, schema=schema)
    folder = shutil.copytree(data_dir, tmp_path / "nulls")
    put_shards(folder / "3x3", "train", [table])
    with pytest.raises(DatasetError, match=message):
        list(load_episodes(folder, "3x3"))


def at_an_end(rows):
    """Return the place of the first row that ends an episode."""
    return next(place for place, row in enumerate(rows) if row["actions"] == -1)


def of_each_row(**values):
    return lambda rows: [row.update(values) for row in rows]


def of_row(place, **values):
    return lambda rows: rows[place].update(values)


def without(column):
    return lambda rows: [row.pop(column) for row in rows]


BEGIN = "row 0 episode_starts: False where an episode must begin"
REPLAYED = "an episode cannot be replayed: "
ROWS = {
    "no last row": (lambda rows: rows.pop(at_an_end(rows)), "an episode ends without its last row"),
    "end missing": (lambda rows: rows.pop(), "the last episode ends without its last row"),
    "first row missing": (lambda rows: rows.pop(0), BEGIN),
    "no start": (of_row(0, episode_starts=False), BEGIN),
    "two starts": (of_row(1, episode_starts=True), "row 1: an episode ends without its last row"),
    "only a last row": (
        lambda rows: rows.insert(0, rows[0] | {"actions": -1}),
        "row 0 actions: -1 in the first row",
    ),
    "labyrinth exchanged": (
        lambda rows: rows[1].update(info=rows[-1]["info"]),
        "row 1: an episode ends without its last row",
    ),
    "no action": (of_row(0, actions=4), f"{REPLAYED}action 4"),
    "another negative action": (of_row(1, actions=-2), f"{REPLAYED}action -2"),
    "step after the goal": (
        lambda rows: rows.insert(at_an_end(rows), rows[at_an_end(rows)] | {"actions": 0}),
        f"{REPLAYED}.* an action follows",
    ),
    "info garbled": (of_each_row(info="labyrinth:\n-----\n"), REPLAYED),
    "info is code": (of_each_row(info="__import__('os').abort()"), REPLAYED),
    "null action": (of_row(0, actions=None), "actions=None: every row needs int"),
    "null info": (of_row(0, info=None), "info=None: every row needs str"),
    "no actions": (without("actions"), "actions=None: every row needs int"),
    "no info": (without("info"), "info=None: every row needs str"),
    "null reward": (of_row(0, rewards=None), "rewards=None: every row needs float"),
}

DECODED = "obs: a picture cannot be decoded: "
PICTURES = {
    "none": (lambda _: None, "obs: a row has no picture"),
    "empty": (lambda _: b"", DECODED),
    "cut short": (lambda png: png[: len(png) // 2], DECODED),
    "a JPEG": (lambda _: b"\xff\xd8\xff\xe0\x00\x10JFIF" + bytes(100), DECODED),
    "another size": (
        lambda _: encode([((bytes(900), 200),)], 300),
        f"{DECODED}it has 300 x 200 pixels",
    ),
    "a claim to be huge": (lambda png: png[:16] + b"\x00\x00\xff\xff" * 2 + png[24:], DECODED),
}


def edited(data_dir, folder, edit=lambda _: None):
    """Return a copy of the datasets; train of 3x3 is one shard, its rows changed."""
    shutil.copytree(data_dir, folder)
    table = pq.read_table(shards_of(folder, "3x3", "train")[0])
    rows = table.to_pylist()
    edit(rows)
    schema = pa.schema([field for field in table.schema if field.name in rows[0]])
    put_shards(folder / "3x3", "train", [pa.Table.from_pylist(rows, schema)])
    return folder


def assert_refused(folder, message):
    """Check that both ways to load say the same thing."""
    for load in (load_episodes, stream_episodes):
        with pytest.raises(DatasetError, match=message) as refusal:
            list(load(folder, "3x3", image_size=8))
        assert re.fullmatch(r"[^\n]+", str(refusal.value))
    with pytest.raises(DatasetError, match=message):
        load_transitions(folder, "3x3", image_size=8)


@pytest.mark.slow
@pytest.mark.parametrize(("edit", "message"), ROWS.values(), ids=ROWS)
def test_rows_that_make_no_episodes_are_refused(data_dir, tmp_path, edit, message):
    folder = edited(data_dir, tmp_path / "damaged", edit)
    assert_refused(folder, message)
    with pytest.raises(DatasetError, match=message):
        load_transitions(folder, "3x3", image_size=8, draw=True)


@pytest.mark.parametrize("place", ["first", "last"])
@pytest.mark.parametrize(
    ("height", "task", "words"),
    [(4, Task.NAVIGATION, "4x3, navigation"), (3, Task.ICY_FLOOR, "3x3, icy_floor")],
)
def test_a_labyrinth_of_another_size_or_task_than_the_dataset_is_refused(
    data_dir, tmp_path, height, task, words, place
):
    other = sample_labyrinth(height, 3, task, np.random.default_rng(0))
    rows = episode_rows("train", 0, other, Solver(other).shortest_routes()[0])

    def mix(own):
        own[:] = [*rows, *own] if place == "first" else [*own, *rows]

    folder = edited(data_dir, tmp_path / "mixed", mix)
    assert_refused(folder, rf"\Ainfo: a labyrinth of {words}, in a dataset of 3x3, navigation\Z")
    with pytest.raises(DatasetError, match=words):
        load_arrays(folder, "3x3", "train", observation="vector")


@pytest.mark.parametrize(("edit", "message"), PICTURES.values(), ids=PICTURES)
def test_a_picture_that_is_none_is_refused(data_dir, tmp_path, edit, message):
    def edit_picture(rows):
        rows[1]["obs"]["bytes"] = edit(rows[1]["obs"]["bytes"])

    assert_refused(edited(data_dir, tmp_path / "damaged", edit_picture), message)


def test_vectors_need_no_pictures(data_dir, tmp_path):
    def remove_pictures(rows):
        for row in rows:
            row["obs"]["bytes"] = None

    folder = edited(data_dir, tmp_path / "without", remove_pictures)
    whole = edited(data_dir, tmp_path / "with")
    for load in (load_episodes, stream_episodes):
        assert_same_episodes(
            load(folder, "3x3", observation="vector"), load(whole, "3x3", observation="vector")
        )


@LOADS
@pytest.mark.parametrize("damage", ["missing", "one bit"])
def test_a_file_that_is_no_shard_is_refused(data_dir, tmp_path, load, damage):
    folder = edited(data_dir, tmp_path / "damaged")
    (path,) = shards_of(folder, "3x3", "train")
    whole = path.read_bytes()
    path.unlink()
    if damage == "one bit":
        path.write_bytes(whole[:200] + bytes([whole[200] ^ 1]) + whole[201:])
    message = "is missing: build it again" if damage == "missing" else "is damaged: its sha256"
    with pytest.raises(DatasetError, match=rf"\A[^\n]*{message}[^\n]+\Z"):
        list(load(folder, "3x3"))


@pytest.mark.parametrize(
    "index",
    [True, False, np.True_, None, np.zeros((2, 2), np.int64), [[0, 1]], (slice(2), None)],
    ids=str,
)
def test_an_index_that_would_add_an_axis_is_refused(data_dir, index):
    transitions = load_transitions(data_dir, "3x3", observation="vector")
    with pytest.raises(IndexError, match=r"index=.*: give a number, a slice, or one axis of "):
        transitions[index]


@pytest.mark.parametrize("index", [2, -1, np.int64(2), np.array(2)], ids=repr)
def test_a_number_gives_a_transition_and_one_axis_a_batch(data_dir, index):
    transitions = load_transitions(data_dir, "3x3", observation="vector")
    expected = transitions.observations[int(index)]
    assert np.array_equal(transitions[index].observation, expected)
    mask = np.zeros(len(transitions), np.bool_)
    mask[int(index)] = True
    for several in ([int(index)], np.array([index]), mask, mask.tolist()):
        assert np.array_equal(transitions[several].observation, [expected])

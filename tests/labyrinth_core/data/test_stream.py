"""Streams: everything once an epoch among all, in an order that follows from seed and epoch."""

from __future__ import annotations

import copy
import gc
import json
import pickle
import shutil
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from itertools import islice
from pathlib import Path
from types import SimpleNamespace
from unittest import mock
from weakref import WeakSet

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.tampering import put_shards

from labyrinth_core import (
    DatasetError,
    load_episodes,
    load_transitions,
    stream_episodes,
    stream_transitions,
)
from labyrinth_core.data import Manifest, dataset
from labyrinth_core.data import stream as streaming

CONFIG = "3x4"
VECTOR = {"observation": "vector"}
GROUPS = (2, 7, 40, 0)
"""Rows a row group, which end within episodes; 0 for a row group an episode."""

ORDERS = st.one_of(st.booleans(), st.integers(1, 60))


@pytest.fixture(scope="module")
def folders(build, tmp_path_factory):
    """The same dataset of three shards, in row groups of other lengths."""
    folder = tmp_path_factory.mktemp("data")
    run = build(folder / "whole", size="3x4", labyrinths=12, cells_per_shard=48, random_steps=60)
    found = {}
    for rows in GROUPS:
        found[rows] = Path(shutil.copytree(run.data_dir, folder / str(rows)))
        manifest = Manifest.read(run.folder)
        for split in manifest.config.splits:
            tables = [pq.read_table(run.folder / shard.path) for shard in manifest.of(split)]
            put_shards(found[rows] / CONFIG, split, tables, partial(groups_of, rows=rows))
    return found


def groups_of(table, rows):
    """Return the first row of each row group."""
    return range(0, len(table), rows) if rows else np.flatnonzero(table["episode_starts"])


@pytest.fixture(autouse=True)
def no_torchrun(monkeypatch):
    for name in ("RANK", "WORLD_SIZE"):
        monkeypatch.delenv(name, raising=False)


@pytest.fixture(autouse=True)
def small_groups_may_end_within_episodes(monkeypatch):
    """As large ones do, those of 64 MiB, which would take long to make."""
    monkeypatch.setattr(dataset, "FULL", 0)


@contextmanager
def worker(number: int, of: int) -> Iterator[None]:
    """Be a worker of a `DataLoader`."""
    info = SimpleNamespace(id=number, num_workers=of)
    torch_data = SimpleNamespace(get_worker_info=lambda: info)
    with mock.patch.dict(sys.modules, {"torch.utils.data": torch_data}):
        yield


def keys(items):
    """Return what an episode or a transition is known by, of each."""
    return [
        (each.observation.tobytes(), each.action, each.next_observation.tobytes())
        if hasattr(each, "action")
        else (each.info, each.observations.tobytes(), each.actions.tobytes())
        for each in items
    ]


PLACES = st.tuples(st.sampled_from(GROUPS), st.sampled_from(["train", "random"]))


@pytest.mark.slow
@settings(max_examples=15)
@given(PLACES, st.integers(1, 4), st.integers(1, 3), ORDERS, st.integers(0, 2), st.booleans())
def test_all_ranks_and_workers_together_get_every_item_once_an_epoch(
    folders, place, ranks, workers, shuffle, epoch, part
):
    folder, split = folders[place[0]], place[1]
    options = {"split": split, "where": pc.field("moves") >= 6 if part else None, **VECTOR}
    expected = Counter(keys(load_episodes(folder, CONFIG, **options)))
    met: Counter[tuple] = Counter()
    for rank in range(ranks):
        stream = stream_episodes(
            folder, CONFIG, shuffle=shuffle, rank=rank, world_size=ranks, **options
        )
        stream.set_epoch(epoch)
        for number in range(workers):
            with worker(number, workers):
                met.update(keys(stream))
    assert met == expected


@pytest.mark.slow
@settings(max_examples=15)
@given(PLACES, ORDERS, st.integers(0, 2), st.integers(0, 2), st.data())
def test_after_a_state_is_loaded_the_rest_is_the_rest(folders, place, shuffle, epoch, number, data):
    def stream():
        return stream_transitions(
            folders[place[0]],
            CONFIG,
            split=place[1],
            shuffle=shuffle,
            rank=1,
            world_size=2,
            **VECTOR,
        )

    with worker(number, 3):
        one, other = stream(), stream()
        one.set_epoch(epoch)
        every = keys(one)
        taken = data.draw(st.integers(0, len(every)))
        items = iter(one)
        assert keys(islice(items, taken)) == every[:taken]
        state = json.loads(json.dumps(one.state_dict()))
        assert keys(items) == every[taken:]
        other.load_state_dict(state)
        assert other.state_dict() == state
        assert keys(other) == every[taken:]
        assert keys(other) == every  # From the beginning of the same epoch.


@pytest.mark.slow
@settings(max_examples=6)
@given(st.sampled_from(GROUPS), st.integers(20, 60), st.integers(0, 9))
def test_the_order_follows_from_seed_and_epoch(folders, rows, buffer, seed):
    def order(seed, epoch):
        stream = stream_episodes(folders[rows], CONFIG, shuffle=buffer, seed=seed, **VECTOR)
        stream.set_epoch(epoch)
        return keys(stream)

    assert order(seed, 1) == order(seed, 1)
    assert order(seed, 1) != order(seed, 2)
    assert order(seed, 1) != order(seed + 10, 1)


@pytest.mark.slow
def test_without_shuffle_all_come_in_order(folders):
    for folder in folders.values():
        for options in ({"image_size": 8}, VECTOR):
            loaded = load_transitions(folder, CONFIG, cache_dir=False, **options)
            assert keys(stream_transitions(folder, CONFIG, **options)) == keys(loaded)


@pytest.mark.parametrize("buffer", [1, 100, 200])
def test_no_more_is_held_than_the_buffer_and_one_item(folders, monkeypatch, buffer):
    place = folders[0], CONFIG
    longest = max(len(each) + 1 for each in load_episodes(*place, split="random", **VECTOR))
    alive = WeakSet()

    whole_episodes = streaming._whole_episodes

    def noted(block, spec):
        for episode in whole_episodes(block, spec):
            alive.add(episode)
            yield episode

    monkeypatch.setattr(streaming, "_whole_episodes", noted)
    for _ in stream_episodes(*place, split="random", shuffle=buffer, **VECTOR):
        assert 0 < sum(len(each) + 1 for each in alive) <= max(buffer, longest) + longest


def test_whoever_holds_the_last_item_of_an_episode_holds_one_picture(folders):
    lengths = [len(each) for each in load_episodes(folders[7], CONFIG, **VECTOR)]
    items = list(stream_transitions(folders[7], CONFIG, image_size=8))
    for last in np.cumsum(lengths) - 1:
        assert items[last].observation.base is None


def test_ranks_are_those_of_torchrun_unless_given(folders, monkeypatch):
    def share(**given):
        return keys(stream_episodes(folders[7], CONFIG, **given, **VECTOR))

    every, second = share(), share(rank=1, world_size=2)
    assert 0 < len(second) < len(every)
    monkeypatch.setenv("RANK", "1")
    monkeypatch.setenv("WORLD_SIZE", "2")
    assert share() == second
    assert share(rank=0, world_size=1) == every


@pytest.mark.parametrize(
    ("environment", "message"),
    [
        ({"WORLD_SIZE": "4"}, "RANK=None: give a whole number from 0 to 3, as WORLD_SIZE=4; or "),
        ({"WORLD_SIZE": "4", "RANK": ""}, "RANK='': give a whole number from 0 to 3"),
        ({"WORLD_SIZE": "4", "RANK": "4"}, "RANK=4: give a whole number from 0 to 3"),
        ({"RANK": "1"}, "RANK=1: give a whole number from 0 to 0, as WORLD_SIZE=1"),
        ({"WORLD_SIZE": "", "RANK": "0"}, "WORLD_SIZE='': give a whole number from 1 on"),
    ],
)
def test_half_of_what_torchrun_sets_is_refused(folders, monkeypatch, environment, message):
    for name, value in environment.items():
        monkeypatch.setenv(name, value)
    with pytest.raises(ValueError, match=rf"\A{message}"):
        stream_transitions(folders[7], CONFIG)
    whole = stream_episodes(folders[7], CONFIG, rank=0, world_size=1, **VECTOR)
    assert keys(whole) == keys(load_episodes(folders[7], CONFIG, **VECTOR))


def test_a_stream_may_be_used_like_a_generator(folders):
    expected = keys(load_episodes(folders[7], CONFIG, **VECTOR))
    stream = stream_episodes(folders[7], CONFIG, **VECTOR)
    assert keys([next(stream), next(stream)]) == expected[:2]
    assert keys(pickle.loads(pickle.dumps(stream))) == expected
    stream.close()
    assert list(islice(iter(lambda: next(stream, None), None), 1)) == []


@pytest.mark.slow  # A process of its own, which imports torch late.
def test_a_data_loader_over_a_stream_made_before_torch_was_imported_says_what_to_do(folders):
    program = f"""
from labyrinth_core import stream_episodes
stream = stream_episodes({str(folders[7])!r}, {CONFIG!r}, observation="vector")
assert stream
from torch.utils.data import DataLoader
for options in ({{}}, {{"num_workers": 1}}, {{"batch_size": None}}, {{"shuffle": True}}):
    try:
        next(iter(DataLoader(stream, **options)))
    except TypeError as error:
        print(error)
"""
    command = [sys.executable, "-c", program]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    lines = done.stdout.splitlines()
    assert len(lines) == 4
    assert all(line.endswith("before torch was imported: import torch first") for line in lines)


def test_rows_lost_between_two_groups_are_missed(folders, tmp_path, monkeypatch):
    monkeypatch.setattr(dataset, "FULL", 1 << 24)  # The table, which has the old rows, is not read.
    folder = Path(shutil.copytree(folders[7], tmp_path / "damaged"))
    paths = [folder / CONFIG / each.path for each in Manifest.read(folder / CONFIG).of("train")]
    table, *others = map(pq.read_table, paths)
    end = table["actions"].to_pylist().index(-1) + 1
    rows = pa.concat_tables([table.slice(0, end), table.slice(end + 1)])
    put_shards(folder / CONFIG, "train", [rows, *others], lambda _: [0, end])
    with worker(1, 2), pytest.raises(DatasetError, match="episode_starts: False where"):
        list(stream_episodes(folder, CONFIG, **VECTOR))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"shuffle": 0}, "shuffle=0: give True, False or a number of rows from 1 on"),
        ({"shuffle": "yes"}, "shuffle='yes': give True, False or a number of rows from 1 on"),
        ({"seed": -1}, "seed=-1: give a whole number from 0 on"),
        ({"rank": 2, "world_size": 2}, "rank=2: give a whole number from 0 to 1"),
        ({"rank": 0}, "world_size=None: give a whole number from 1 on"),
        ({"world_size": 2}, "rank=None: give a whole number from 0 to 1"),
        ({"rank": 0, "world_size": 0}, "world_size=0: give a whole number from 1 on"),
    ],
)
def test_an_impossible_order_or_share_is_refused_at_once(folders, options, message):
    with pytest.raises(ValueError, match=rf"\A{message}\Z"):
        stream_transitions(folders[7], CONFIG, **options)


def test_a_state_or_epoch_that_cannot_be_is_refused(folders):
    stream = stream_episodes(folders[7], CONFIG, shuffle=30, **VECTOR)
    state = stream.state_dict()
    for wrong in ({}, state | {"item": -1}, state | {"epoch": "1"}, {**state, "more": 1}):
        with pytest.raises(
            ValueError, match=r"\Aload_state_dict: .* is not a result of state_dict\Z"
        ):
            stream.load_state_dict(wrong)
    same = {"shuffle": 30}
    for folder, options in (
        (folders[7], {"shuffle": 31}),
        (folders[7], {}),
        (folders[7], same | {"split": "random"}),
        (folders[7], same | {"labyrinths": 3}),
        (folders[7], same | {"rank": 0, "world_size": 2}),
        (folders[2], same),
    ):
        other = stream_episodes(folder, CONFIG, **options, **VECTOR)
        with pytest.raises(
            ValueError, match=r"\Aload_state_dict: the state is of another stream: [^\n]+\Z"
        ):
            other.load_state_dict(state)
    stream.load_state_dict(state)
    with worker(0, 2), pytest.raises(ValueError, match="another stream"):
        iter(stream)
    with pytest.raises(ValueError, match=r"\Aepoch=-1: give a whole number from 0 to \d+\Z"):
        stream.set_epoch(-1)


def test_a_loop_that_sets_the_epoch_gets_another_order_in_each(folders):
    # As the callback for Lightning in docs/loading.md does, which calls `set_epoch` for samplers
    # alone.
    stream = stream_episodes(folders[7], CONFIG, shuffle=True, **VECTOR)
    orders = []
    for epoch in range(3):
        stream.set_epoch(epoch)
        orders.append(keys(stream))
    assert orders[0] != orders[1] != orders[2] != orders[0]
    assert Counter(orders[0]) == Counter(orders[1]) == Counter(orders[2])


@pytest.mark.parametrize("shuffle", [False, 30])
@pytest.mark.parametrize("options", [VECTOR, {"image_size": 8}, {"observation": "text"}], ids=str)
def test_items_share_no_memory_that_can_be_written(folders, shuffle, options):
    place, written = (folders[7], CONFIG), stream_transitions
    expected = keys(written(*place, shuffle=shuffle, **options))
    met = []
    for item in written(*place, shuffle=shuffle, **options):
        met += keys([item])
        for array in (item.observation, item.next_observation):
            if isinstance(array, np.ndarray):
                array[...] = 0
    assert met == expected


def test_next_follows_the_state_and_the_epoch_that_are_set(folders):
    stream = stream_transitions(folders[7], CONFIG, shuffle=30, **VECTOR)
    every = keys(stream)
    items = iter(stream)
    assert keys(islice(items, 20)) == every[:20]
    state = stream.state_dict()
    stream.load_state_dict(
        stream_transitions(folders[7], CONFIG, shuffle=30, **VECTOR).state_dict()
    )
    assert keys([next(stream), next(stream)]) == every[:2]
    stream.load_state_dict(state)
    assert stream.state_dict() == state
    assert keys([next(stream)]) == every[20:21]
    stream.set_epoch(0)  # The same.
    assert keys([next(stream)]) == every[21:22]
    stream.set_epoch(1)
    other = stream_transitions(folders[7], CONFIG, shuffle=30, **VECTOR)
    other.set_epoch(1)
    assert stream.state_dict() == other.state_dict()
    assert keys([next(stream)]) == keys(other)[:1]
    stream.close()
    stream.load_state_dict(state)
    assert keys([next(stream)]) == every[20:21]


@pytest.mark.parametrize(
    "copied", [copy.deepcopy, copy.copy, lambda s: pickle.loads(pickle.dumps(s))]
)
def test_a_copy_says_where_it_begins(folders, copied):
    stream = stream_transitions(folders[7], CONFIG, **VECTOR)
    every, start = keys(stream), stream.state_dict() | {"shard": 0}
    stream = stream_transitions(folders[7], CONFIG, **VECTOR)
    for _ in range(3):
        next(stream)
    third = stream.state_dict()
    other = copied(stream)
    assert other.state_dict() == start
    assert keys([next(other)]) == every[:1]
    assert stream.state_dict() == third
    stream.load_state_dict(third)
    other = copied(stream)
    assert other.state_dict() == third
    assert keys([next(other)]) == every[3:4]


def test_a_position_past_the_end_is_refused(folders):
    stream = stream_transitions(folders[7], CONFIG, **VECTOR)
    state = stream.state_dict()
    shards = len(Manifest.read(folders[7] / CONFIG).of("train"))
    end = state | {"shard": shards}
    stream.load_state_dict(end)
    assert list(stream) == []
    for wrong in (state | {"shard": shards + 1}, end | {"part": 1}, end | {"item": 1}):
        with pytest.raises(ValueError, match=r"\Aload_state_dict: shard=.* is past the end"):
            stream.load_state_dict(wrong)
    for wrong in (state | {"part": 10**6}, state | {"item": 10**6}, state | {"item": 2**63 - 1}):
        stream.load_state_dict(wrong)
        with pytest.raises(ValueError, match=r"\Aload_state_dict: shard=0, .* is past the end"):
            next(stream)


@pytest.mark.parametrize("state", [None, 3, "state", [("shard", 1)], {}], ids=str)
def test_what_is_no_state_is_refused(folders, state):
    stream = stream_transitions(folders[7], CONFIG, **VECTOR)
    with pytest.raises(ValueError, match=r"\Aload_state_dict: .* is not a result of state_dict\Z"):
        stream.load_state_dict(state)


def test_the_last_epoch_is_the_largest_that_workers_can_share(folders):
    stream = stream_transitions(folders[7], CONFIG, shuffle=30, **VECTOR)
    stream.set_epoch(2**63 - 1)
    state = stream.state_dict()
    next(stream)
    stream.load_state_dict(state)
    with pytest.raises(ValueError, match=rf"\Aepoch={2**63}: give a whole number from 0 to "):
        stream.set_epoch(2**63)
    with pytest.raises(ValueError, match="is not a result of state_dict"):
        stream.load_state_dict(state | {"epoch": 2**63})


@pytest.mark.parametrize("begin", [iter, lambda stream: stream])
def test_a_stream_that_is_dropped_midway_closes_its_file_at_once(folders, begin):
    def count():
        return len(list(Path("/proc/self/fd").iterdir()))

    gc.collect()
    gc.disable()
    try:
        before = count()
        for options in 5 * [VECTOR, {"image_size": 8}]:
            next(begin(stream_transitions(folders[7], CONFIG, shuffle=30, **options)))
        assert count() <= before
    finally:
        gc.enable()


@pytest.mark.parametrize("error", [KeyError("typo"), ValueError("typo"), OSError("typo")])
@pytest.mark.parametrize("read", [load_episodes, load_transitions, stream_episodes])
@pytest.mark.parametrize("place", ["rows.rows_of_table", "rows.joined", "load.replayed"])
def test_a_bug_in_our_code_is_not_told_as_an_unreadable_file(
    folders, monkeypatch, error, read, place
):
    def broken(*_, **__):
        raise error

    monkeypatch.setattr(f"labyrinth_core.data.{place}", broken)
    with pytest.raises(type(error), match="typo") as caught:
        list(read(folders[7], CONFIG, **VECTOR))
    assert caught.value is error

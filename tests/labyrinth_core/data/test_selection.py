"""The first labyrinths of a split, and those that a filter of the table leaves."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
import pytest
from support.tampering import put_shards

from labyrinth_core import (
    hub,
    load_arrays,
    load_episodes,
    load_transitions,
    stream_episodes,
    stream_transitions,
)
from labyrinth_core.data import TABLE_COLUMNS, Manifest
from labyrinth_core.errors import DatasetError

FIELDS = ("frames", "rows", "actions", "rewards", "terminated", "labyrinth_ids")


@pytest.fixture(scope="module")
def data_dir(build, tmp_path_factory):
    """A dataset of nine labyrinths a split, in three shards each."""
    run = build(
        tmp_path_factory.mktemp("data"),
        size="3x4",
        labyrinths=9,
        cells_per_shard=3 * 12,
        solutions="all",
        random_steps=40,
    )
    return run.data_dir


@pytest.fixture(autouse=True)
def cache_of_its_own(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))


def load(data_dir, **options):
    return load_transitions(data_dir, "3x4", **{"image_size": 8} | options)


def ids_of(episodes):
    return list(dict.fromkeys(episode.labyrinth_id for episode in episodes))


def filtered_by_hand(data_dir, split, keep):
    rows = pq.read_table(data_dir / "3x4" / Manifest.TABLE).to_pylist()
    return [int(row["labyrinth_id"], 16) for row in rows if row["split"] == split and keep(row)]


# The first labyrinths.


@pytest.mark.slow
@pytest.mark.parametrize("observation", ["image", "vector"])
@pytest.mark.parametrize("split", ["train", "random"])
@pytest.mark.parametrize("count", [1, 3, 4, 8, 9])
def test_the_first_labyrinths_are_the_beginning_of_all(data_dir, observation, split, count):
    whole = load(data_dir, split=split, observation=observation)
    part = load(data_dir, split=split, observation=observation, labyrinths=count)
    assert len(np.unique(part.labyrinth_ids)) == count
    assert (len(part) == len(whole)) == (count == 9)
    for name in FIELDS:
        beginning = getattr(whole, name)[: len(getattr(part, name))]
        assert getattr(part, name).tobytes() == beginning.tobytes()


def test_no_shard_is_read_that_holds_none_of_them(data_dir, tmp_path):
    copy = Path(shutil.copytree(data_dir, tmp_path / "copy"))
    (copy / "3x4" / "train-00001-of-00003.parquet").write_bytes(b"damaged")
    assert len(ids_of(load_episodes(copy, "3x4", labyrinths=3))) == 3
    third = pc.field("labyrinth_id") == f"{ids_of(load_episodes(data_dir, '3x4'))[7]:016x}"
    assert len(ids_of(load_episodes(copy, "3x4", where=third))) == 1
    with pytest.raises(DatasetError, match="damaged"):
        list(load_episodes(copy, "3x4", labyrinths=4))


def test_no_row_group_is_read_that_holds_none_of_them(data_dir, tmp_path, monkeypatch):
    folder = Path(shutil.copytree(data_dir, tmp_path / "copy")) / "3x4"
    shards = Manifest.read(folder).of("random")
    table = pa.concat_tables([pq.read_table(folder / shard.path) for shard in shards])
    put_shards(folder, "random", [table], lambda _: range(0, len(table), 7))  # Within episodes.
    episodes = list(load_episodes(data_dir, "3x4", split="random", image_size=8))
    ids, groups = ids_of(episodes), []
    iter_batches = pq.ParquetFile.iter_batches

    def spy(file, size, some, columns):
        groups.extend(some)
        return iter_batches(file, size, some, columns)

    monkeypatch.setattr(pq.ParquetFile, "iter_batches", spy)
    wanted = [ids[0], ids[-1]]
    where = pc.field("labyrinth_id").isin([f"{number:016x}" for number in wanted])
    found = list(load_episodes(folder.parent, "3x4", split="random", where=where, image_size=8))
    expected = [each for each in episodes if each.labyrinth_id in wanted]
    assert [each.actions.tolist() for each in found] == [each.actions.tolist() for each in expected]
    rows = sum(len(each) + 1 for each in expected)
    assert groups == sorted(set(groups))
    assert len(groups) <= rows / 7 + 2 * len(wanted) < len(table) / 7


def test_other_labyrinths_have_another_cache_file_and_all_have_the_one_without(data_dir, tmp_path):
    for options in ({"labyrinths": 2}, {"labyrinths": 3}, {"where": pc.field("moves") >= 6}):
        load(data_dir, cache_dir=tmp_path / "some", **options)
    assert len(list((tmp_path / "some").iterdir())) == 3
    for options in ({}, {"labyrinths": 9}, {"where": pc.field("moves") >= 0}):
        load(data_dir, cache_dir=tmp_path / "all", **options)
    assert len(list((tmp_path / "all").iterdir())) == 1


# A filter.


@pytest.mark.slow
@pytest.mark.parametrize("split", ["train", "s0_and_g"])
@pytest.mark.parametrize(
    ("where", "keep"),
    [
        (None, lambda _: True),
        (pc.field("moves") >= 6, lambda row: row["moves"] >= 6),
        (pc.field("loops") == 0, lambda row: row["loops"] == 0),
        (
            (pc.field("optimal_routes") > 1) | (pc.field("turns") < 3),
            lambda row: row["optimal_routes"] > 1 or row["turns"] < 3,
        ),
    ],
    ids=["none", "a number", "a number of nothing", "either of two"],
)
@pytest.mark.parametrize("count", [None, 1, 2])
def test_labyrinths_are_those_of_the_table_that_a_filter_leaves(
    data_dir, split, where, keep, count
):
    expected = filtered_by_hand(data_dir, split, keep)
    assert (len(expected) == 9) == (where is None)
    expected = expected[:count]
    options = {"split": split, "where": where, "labyrinths": count}
    for load_some in (load_episodes, stream_episodes):
        assert ids_of(load_some(data_dir, "3x4", observation="vector", **options)) == expected
    for load_some in (load_transitions, load_arrays):
        loaded = load_some(data_dir, "3x4", image_size=8, **options)
        assert list(dict.fromkeys(loaded.labyrinth_ids.tolist())) == expected


@pytest.mark.parametrize(
    "edit",
    [
        lambda table: table.set_column(
            table.schema.get_field_index("first_row"),
            "first_row",
            pc.add(table["first_row"], 10**6),
        ),
        lambda table: table.set_column(
            table.schema.get_field_index("rows"), "rows", pa.nulls(len(table), pa.int32())
        ),
        lambda table: table.drop_columns(["rows"]),
    ],
    ids=["rows that no shard has", "nulls", "a column less"],
)
def test_a_table_of_other_rows_than_the_shards_is_refused(data_dir, tmp_path, edit):
    folder = Path(shutil.copytree(data_dir, tmp_path / "copy")) / "3x4"
    pq.write_table(edit(pq.read_table(folder / Manifest.TABLE)), folder / Manifest.TABLE)
    Manifest.read(folder).with_table(folder / Manifest.TABLE).write(folder)
    with pytest.raises(DatasetError, match=rf"\A[^\n]*{Manifest.TABLE}[^\n]*\Z"):
        list(load_episodes(folder.parent, "3x4", labyrinths=2))


# From elsewhere.


def test_from_a_url_they_are_the_same(data_dir):
    url, where = f"local://{data_dir}", pc.field("moves") >= 6
    for options in ({"labyrinths": 4}, {"where": where}):
        there = ids_of(load_episodes(url, "3x4", observation="vector", **options))
        assert there == ids_of(load_episodes(data_dir, "3x4", observation="vector", **options))


@pytest.mark.parametrize(
    ("options", "asked"),
    [
        ({"split": "s0", "revision": "v1"}, [f"s0-0000{n}-of-00003.parquet" for n in range(3)]),
        (
            {"split": "test", "labyrinths": 4},
            [Manifest.TABLE, *(f"test-0000{n}-of-00003.parquet" for n in (0, 1))],
        ),
    ],
    ids=["all", "some"],
)
def test_from_the_hub_come_only_the_shards_that_hold_some(data_dir, monkeypatch, options, asked):
    calls = []

    def download(*source, names):
        calls.append(names)
        assert source == ("user/labyrinth", "dataset", f"{options.get('revision')} now")
        return data_dir

    monkeypatch.setattr(hub, "commit_of", lambda *source: f"{source[2]} now")
    monkeypatch.setattr(hub, "download", lambda *source: download(*source[:3], names=source[3]))
    from_hub = load_episodes("user/labyrinth", "3x4", observation="vector", **options)
    local = {name: options[name] for name in options if name != "revision"}
    assert ids_of(from_hub) == ids_of(load_episodes(data_dir, "3x4", **local))
    names = [name.removeprefix("3x4/") for names in calls for name in names]
    assert [name for name in names if name != Manifest.FILE] == asked


# Errors of a user.

ALL = (load_transitions, load_episodes, stream_episodes, stream_transitions)


def refusal(data_dir, **options):
    """Return the one line with which every function refuses its arguments."""
    lines = set()
    for function in ALL:
        with pytest.raises((ValueError, DatasetError)) as error:
            function(data_dir, "3x4", **options)
        lines.add(str(error.value))
    (line,) = lines
    assert "\n" not in line
    return line


WHERE = pc.field("moves") >= 6
COUNTED = "give a whole number from 1 to {left}, as many as split=train has"


@pytest.mark.parametrize(
    ("options", "message"),
    [
        *(
            ({"labyrinths": count}, f"labyrinths={count!r}: {COUNTED.format(left=9)}$")
            for count in (0, -1, 10, True, 2.5, "3")
        ),
        (
            {"labyrinths": 9, "where": WHERE},
            rf"labyrinths=9: {COUNTED.format(left='[1-8]')} where \(moves >= 6\)$",
        ),
        (
            {"where": pc.field("lenght") >= 3},
            r"where=\(lenght >= 3\): No match for FieldRef.Name\(lenght\); .* "
            + ", ".join(column.name for column in TABLE_COLUMNS),
        ),
        ({"where": pc.field("moves") == "a"}, r"where=\(moves == "),
        ({"where": pc.field("moves") + 1}, r"where=add\w*\(moves, 1\): "),
        ({"where": pc.field("turns") > pc.field("task")}, r"where=\(turns > task\): "),
        ({"where": pc.field("moves") > 99}, ".*: split=train has no such labyrinth$"),
        *(
            ({"where": text}, "where=.*: give an expression, such as pyarrow.compute.field")
            for text in ("moves >= 12", [("moves", ">=", 12)], True)
        ),
        ({"split": "g", "labyrinths": 1}, "split=g: the dataset has train"),
    ],
    ids=str,
)
def test_a_selection_that_cannot_be_is_refused(data_dir, options, message):
    assert re.match(message, refusal(data_dir, **options))

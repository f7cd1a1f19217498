"""Validation finds damaged files and content that means harm, and evaluates nothing of it."""

from __future__ import annotations

import shutil
import struct
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from support.making import Run
from support.planting import write
from support.tampering import (
    OTHER,
    RANDOM,
    TRAIN,
    episode_starts,
    manifest_of,
    names,
    problems,
    read_rows,
    rows_of,
)

from labyrinth_core.data import COLUMNS, SPLITS
from labyrinth_core.data import manifest as listing
from labyrinth_core.language import dump
from labyrinth_core.world import Labyrinth, Structure
from pipeline.generation import check as checking

# A file that is not read, as its footer shows that it is not ours.


@pytest.mark.parametrize("wrong", ["rows", "groups"])
def test_a_file_that_may_be_huge_is_not_read(
    folder: Path, monkeypatch: pytest.MonkeyPatch, wrong: str
) -> None:
    if wrong == "groups":
        monkeypatch.setattr(listing, "MOST_ROWS", 5)
        expected = "a row group has "
    else:
        expected = "rows "
        with manifest_of(folder) as content:
            for shard in content["shards"]:
                shard["rows"] += 1
    monkeypatch.delattr(pq.ParquetFile, "iter_batches")
    found = problems(folder)
    assert len(found) == len(SPLITS.base)
    assert all(f".parquet: {expected}" in problem for problem in found)


# Files and the manifest.


def test_a_missing_shard_is_found(folder: Path) -> None:
    (folder / "s0-00000-of-00001.parquet").unlink()
    assert problems(folder) == ["s0-00000-of-00001.parquet is missing"]


def test_a_shard_without_a_labyrinth_leaves_the_ids_of_structures_whole_numbers(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As numbers with a fraction, ids of 63 bits that differ would be equal."""
    with rows_of(folder) as rows:
        for row in rows:
            row["info"] = ""
    check_shard, found = checking.check_shard, list[str]()

    def noted(job: checking.CheckJob) -> checking.ShardReport:
        report = check_shard(job)
        found.append(f"{len(report.structures)} {report.structures.dtype}")
        return report

    monkeypatch.setattr(checking, "check_shard", noted)
    problems(folder)
    assert found == ["0 int64", *["3 int64"] * 2, *["0 int64"] * 3]


def test_a_split_that_the_manifest_lost_is_found(folder: Path) -> None:
    with manifest_of(folder) as content:
        lost = content["shards"].pop()
    found = problems(folder)
    assert f"{lost['path']} is not in the manifest" in found
    assert f"{lost['split']} holds 0 labyrinths, not 3" in found


def test_a_file_beside_the_shards_that_would_be_loaded_with_them_is_found(folder: Path) -> None:
    shutil.copy(folder / TRAIN, folder / "train-00001-of-00001.parquet")
    assert problems(folder) == ["train-00001-of-00001.parquet is not in the manifest"]


@pytest.mark.parametrize(
    "damaged",
    [
        lambda content: content[: len(content) // 2],
        lambda content: content[:-8] + bytes(8),
        lambda _: bytes(range(256)) * 40,
        lambda _: b"",
        None,
    ],
    ids=["truncated", "no footer", "garbage", "empty", "a folder"],
)
def test_a_damaged_file_is_found(folder: Path, damaged: Callable[[bytes], bytes] | None) -> None:
    path = folder / TRAIN
    content = path.read_bytes()
    path.unlink()
    if damaged is None:
        path.mkdir()
    else:
        path.write_bytes(damaged(content))
    first, *others = problems(folder)
    assert first.startswith(f"{TRAIN} cannot be read: ")
    assert [other.partition("-")[0] for other in others] == ["random", "s0", "s0_and_g"]
    assert all(f"cannot be compared with {TRAIN}" in other for other in others)


def test_shifts_that_are_not_compared_with_train_are_named(
    build: Callable[..., Run], tmp_path: Path
) -> None:
    """Each labyrinth of `open` has more loops than any of train."""
    folder = build(tmp_path, labyrinths=3, random_steps=30, shifts=("open",)).folder
    (folder / TRAIN).write_bytes(b"")
    uncompared, unreadable, *_ = problems(folder)
    assert uncompared.startswith("open: not compared with train, which cannot be read: ")
    assert unreadable.startswith(f"{TRAIN} cannot be read: ")


@pytest.mark.slow
def test_a_flipped_bit_anywhere_in_a_file_is_found(folder: Path) -> None:
    path = folder / OTHER
    content = path.read_bytes()
    for place in range(3, len(content), len(content) // 40):
        flipped = bytearray(content)
        flipped[place] ^= 1 << place % 8
        path.write_bytes(flipped)
        assert any(problem.startswith(OTHER) for problem in problems(folder))


def test_a_manifest_that_says_something_else_of_a_shard_is_found(folder: Path) -> None:
    others = {"episodes": 99, "labyrinths": 2, "longest": 3, "cut": 1, "bytes": 555}
    others |= {"sha256": "0" * 64, "fingerprint": "1" * 64}
    with manifest_of(folder) as content:
        shard = content["shards"][1]
        path, before = shard["path"], dict(shard)
        shard |= others
    expected = [
        f"{path}: {name} {before[name]}, but the manifest says {other}"
        for name, other in others.items()
    ]
    assert {*expected} <= {*problems(folder)}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("labyrinths", 4),
        ("solutions", "all"),
        ("random_steps", 31),
        ("height", 4),
        ("task", "icy_floor"),
        ("goals", "varied"),
        ("buckets", [20, 40, 40]),
    ],
)
def test_a_dataset_of_another_configuration_is_found(folder: Path, name: str, value: Any) -> None:
    with manifest_of(folder) as content:
        content["config"][name] = value
    assert problems(folder) != []


# Content that means harm.


def changed_table(folder: Path, change: Callable[[pa.Table], pa.Table]) -> None:
    write(folder, "train", change(pq.read_table(folder / TRAIN)))


def retyped(name: str, type_: pa.DataType) -> Callable[[pa.Table], pa.Table]:
    def change(table: pa.Table) -> pa.Table:
        place = table.schema.get_field_index(name)
        return table.set_column(place, name, pa.nulls(len(table), type_))

    return change


@pytest.mark.slow
@pytest.mark.parametrize(
    "change",
    [
        *(retyped(name, pa.string()) for name in ("obs", "actions")),
        retyped("info", pa.binary()),
        lambda table: table.drop_columns("rewards"),
        lambda table: table.append_column("extra", pa.nulls(len(table))),
        lambda table: table.rename_columns(["obs", "action", "rewards", "episode_starts", "info"]),
        lambda table: table.select(["info", "obs", "actions", "rewards", "episode_starts"]),
    ],
)
def test_other_columns_are_found(folder: Path, change: Callable[[pa.Table], pa.Table]) -> None:
    changed_table(folder, change)
    assert f"{TRAIN}: its columns are not a dataset's" in problems(folder)


@pytest.mark.parametrize(
    ("row", "column"),
    [
        (0, "info"),
        *((3, name) for name in ("obs", "actions", "rewards", "episode_starts", "info")),
        *((3, f"obs.{part}") for part in ("bytes", "path")),
    ],
)
def test_a_field_that_holds_nothing_is_found(folder: Path, row: int, column: str) -> None:
    rows = read_rows(folder / TRAIN)
    column, _, part = column.partition(".")
    holder, key = (rows[row]["obs"], part) if part else (rows[row], column)
    holder[key] = None
    write(folder, "train", pa.Table.from_pylist(rows, schema=COLUMNS.arrow_schema()))
    assert f"{TRAIN} row {row} {column}: no value" in problems(folder)


def test_text_that_is_not_utf8_is_found(folder: Path) -> None:
    def change(table: pa.Table) -> pa.Table:
        raw = pa.array([b"\xff\xfe"] * len(table), pa.binary()).view(pa.string())
        return table.set_column(
            table.schema.get_field_index("info"), COLUMNS.arrow_schema().field("info"), raw
        )

    changed_table(folder, change)
    assert any(problem.startswith(f"{TRAIN} cannot be read") for problem in problems(folder))


@pytest.mark.slow
@pytest.mark.parametrize(
    "info",
    [
        *("", "labyrinth:\nend\n", "\0", "key_and_lock: True"),
        "\n" * 2_000_000,
        "labyrinth:\n" + "-" * 2_000_001 + "\n",
        "(" * 500_000,
        dump(Labyrinth(Structure.without_walls(300, 300), 0, 89_999)),
        "__import__('pathlib').Path('evaluated').touch()",
        "!!python/object/apply:pathlib.Path.touch [evaluated]",
    ],
    ids=lambda info: repr(info[:20]),
)
def test_an_info_that_is_no_labyrinth_is_found_and_never_evaluated(
    folder: Path, monkeypatch: pytest.MonkeyPatch, info: str
) -> None:
    monkeypatch.chdir(folder.parent)
    with rows_of(folder) as rows:
        start = episode_starts(rows)[2]
        for row in rows[start:]:
            row["info"] = info
    assert names(problems(folder), start, "info")
    assert [path.name for path in folder.parent.iterdir()] == [folder.name]


def chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def header(width: int, height: int) -> bytes:
    return b"\x89PNG\r\n\x1a\n" + chunk(
        b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    )


IDAT = chunk(b"IDAT", zlib.compress(bytes(1801 * 600)))
IEND = chunk(b"IEND", b"")

HOSTILE_PICTURES = {
    "not a picture": b"GIF89a",
    "nothing": b"",
    "a bomb that Pillow warns of": header(10_000, 10_000) + IDAT + IEND,
    "a bomb that Pillow refuses": header(60_000, 60_000) + IDAT + IEND,
    "the largest there can be": header(2**31 - 1, 2**31 - 1) + IEND,
    "no pixels": header(0, 0) + IEND,
    "no data": header(600, 600) + IEND,
    "too little data": header(600, 600) + chunk(b"IDAT", zlib.compress(bytes(99))) + IEND,
    "a text that unpacks to too much": header(600, 600)
    + chunk(b"zTXt", b"a\0\0" + zlib.compress(bytes(2**27)))
    + IDAT
    + IEND,
    "an animation without frames": header(600, 600) + chunk(b"acTL", bytes(8)) + IDAT + IEND,
    "a chunk cut short": header(600, 600) + chunk(b"pHYs", b"\0") + IDAT + IEND,
    "a profile cut short": header(600, 600) + chunk(b"iCCP", b"\0") + IDAT + IEND,
}


@pytest.mark.slow
def test_hostile_pictures_are_found(folder: Path) -> None:
    rows = read_rows(folder / RANDOM)
    for row, picture in zip(rows[2:], HOSTILE_PICTURES.values(), strict=False):
        row["obs"]["bytes"] = picture
    write(folder, "random", pa.Table.from_pylist(rows, schema=COLUMNS.arrow_schema()))
    found = problems(folder)
    places = dict(enumerate(HOSTILE_PICTURES, start=2))
    assert [name for n, name in places.items() if not names(found, n, "obs", RANDOM)] == []

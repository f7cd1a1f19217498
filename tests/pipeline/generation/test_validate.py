"""Validation finds each thing that can be wrong with a dataset, and nothing in a right one."""

from __future__ import annotations

import io
import shutil
import struct
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from PIL import Image
from tampering import (
    TRAIN,
    Rows,
    episode_rows,
    episode_starts,
    manifest_of,
    problems,
    read_rows,
    rows_of,
    with_a_wall_opened,
)

from labyrinth_core.data import rows as reading
from labyrinth_core.data.columns import COLUMNS, arrow_schema
from labyrinth_core.data.errors import DatasetError
from labyrinth_core.data.loader import load_episodes
from labyrinth_core.data.splits import BASE_SPLITS
from labyrinth_core.data.storage import file_sha256
from labyrinth_core.language.text import dump, parse
from labyrinth_core.world.labyrinth import Labyrinth, Structure
from labyrinth_core.world.solver import shortest_routes
from pipeline.config.run import Run
from pipeline.generation import check_shard as checking
from pipeline.generation import validate as validation

Build = Callable[..., Run]

OTHER = "validation-00000-of-00001.parquet"
"""A file whose labyrinths are not the parents of others."""

RANDOM = "random-00000-of-00001.parquet"

FOREIGN = {"zlib": "0.0.0"}
"""Versions that say the bytes of pictures may be others."""


@pytest.fixture(scope="session")
def tiny(build: Build, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a dataset with three labyrinths a split."""
    return build(tmp_path_factory.mktemp("tiny"), labyrinths=3, random_steps=30).folder


@pytest.fixture
def folder(tiny: Path, tmp_path: Path) -> Path:
    """A copy of it, to be tampered with."""
    return Path(shutil.copytree(tiny, tmp_path / tiny.name))


def names(found: list[str], row: int, field: str, file: str = TRAIN) -> bool:
    return any(problem.startswith(f"{file} row {row} {field}: ") for problem in found)


# Nothing wrong.


@pytest.mark.parametrize(
    "options",
    [
        *({"size": "2x4", "labyrinths": 1, "solutions": s} for s in ("shortest", "all")),
        {"size": "4x3", "labyrinths": 3, "task": "key_and_door", "solutions": "all"},
        {"size": "3x4", "labyrinths": 3, "task": "icy_floor", "solutions": "all_shortest"},
        {"size": "4", "labyrinths": 3, "solutions": "all_shortest", "open_walls": 0.5},
        {"size": "4", "labyrinths": 3, "solutions": "all", "solutions_limit": 2},
        {"size": "3", "labyrinths": 3, "random_steps": 1, "buckets": (60, 30, 10)},
    ],
    ids=str,
)
def test_what_was_built_has_no_problems(
    build: Build, tmp_path: Path, options: dict[str, Any]
) -> None:
    assert problems(build(tmp_path, **options | {"random_steps": 40}).folder) == []


def test_right_rows_written_anew_have_no_problems(folder: Path) -> None:
    with rows_of(folder) as rows:
        assert len(episode_starts(rows)) == 3
    assert problems(folder) == []


# A file that is not read, as its footer shows that it is not ours.


@pytest.mark.parametrize("wrong", ["rows", "groups"])
def test_a_file_that_may_be_huge_is_not_read(
    folder: Path, monkeypatch: pytest.MonkeyPatch, wrong: str
) -> None:
    if wrong == "groups":
        monkeypatch.setattr(reading, "MOST_ROWS", 5)
        expected = "a row group of "
    else:
        expected = "rows "
        with manifest_of(folder) as content:
            for shard in content["shards"]:
                shard["rows"] += 1
    monkeypatch.delattr(pq.ParquetFile, "iter_batches")
    found = problems(folder)
    assert len(found) == len(BASE_SPLITS)
    assert all(f".parquet: {expected}" in problem for problem in found)


def test_a_want_of_memory_is_not_taken_for_a_damaged_file(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def read(*_: Any) -> None:
        raise pa.ArrowMemoryError("malloc of size 30000000 failed")

    monkeypatch.setattr(reading, "read_schema", read)
    monkeypatch.setattr(checking, "read_schema", read)
    with pytest.raises(MemoryError):
        problems(folder)
    with pytest.raises(MemoryError):
        list(load_episodes(folder.parent, folder.name))


# Rows that are wrong, though file and manifest agree.


def with_a_wall_more(rows: Rows) -> str:
    return dump(with_a_wall_opened(parse(rows[2]["info"])))


def saved_by_pillow(mode: str = "RGB", **options: Any) -> Callable[[Rows], bytes]:
    def save(rows: Rows) -> bytes:
        file = io.BytesIO()
        picture = Image.open(io.BytesIO(rows[2]["obs"]["bytes"])).convert(mode)
        picture.save(file, "PNG", **options)
        return file.getvalue()

    return save


def with_a_wrong_pixel(rows: Rows) -> bytes:
    picture = Image.open(io.BytesIO(rows[2]["obs"]["bytes"]))
    picture.putpixel((300, 300), (1, 2, 3))
    file = io.BytesIO()
    picture.save(file, "PNG")
    return file.getvalue()


ALONE = [
    *((1, "rewards", value) for value in (1.0, -0.1, 0.0, float("nan"), float("inf"))),
    (-1, "rewards", 1.0),
    (2, "info", with_a_wall_more),
    (2, "path", "\n" * 1_000),
    (2, "bytes", lambda rows: rows[1]["obs"]["bytes"]),
    (2, "bytes", with_a_wrong_pixel),
    (2, "bytes", saved_by_pillow(compress_level=1)),
]
"""Row, column and value of which validation names that field and no other."""

WITH_OTHERS = [
    *((1, "actions", value, 1) for value in (-2, 4, 2**62, -(2**63))),
    (1, "actions", -1, (2, "episode_starts")),
    (2, "episode_starts", True, 2),
    (0, "episode_starts", False, 0),
    *((2, "bytes", saved_by_pillow(mode), 2) for mode in ("RGBA", "L", "P", "1")),
]
"""Row, column and value with the row, and the field if it is another, that validation names."""


def put(rows: Rows, row: int, column: str, value: Any) -> int:
    """Change a field of the first episode; return the number of its row."""
    row = row if row >= 0 else episode_starts(rows)[1] + row
    holder = rows[row]["obs"] if column in ("path", "bytes") else rows[row]
    holder[column] = value(rows) if callable(value) else value
    return row


@pytest.mark.slow
@pytest.mark.parametrize(("row", "column", "value"), ALONE)
def test_a_wrong_field_is_found_and_nothing_else(
    folder: Path, row: int, column: str, value: Any
) -> None:
    with rows_of(folder, OTHER) as rows:
        row = put(rows, row, column, value)
    found = problems(folder)
    assert len(found) == 1
    assert names(found, row, "obs" if column in ("path", "bytes") else column, OTHER)


@pytest.mark.slow
@pytest.mark.parametrize(("row", "column", "value", "place"), WITH_OTHERS)
def test_a_wrong_field_is_found_whatever_follows_from_it(
    folder: Path, row: int, column: str, value: Any, place: int | tuple[int, str]
) -> None:
    with rows_of(folder, OTHER) as rows:
        put(rows, row, column, value)
    field = "obs" if column == "bytes" else column
    where = place if isinstance(place, tuple) else (place, field)
    assert names(problems(folder), *where, OTHER)


@pytest.mark.slow
@pytest.mark.parametrize("change", [1, 2, 3])
@pytest.mark.parametrize("file", [TRAIN, "s0_and_g-00000-of-00001.parquet"])
def test_a_swapped_action_is_found(folder: Path, file: str, change: int) -> None:
    with rows_of(folder, file) as rows:
        places = [n for n, row in enumerate(rows) if row["actions"] >= 0]
        for place in (places[0], places[-1]):
            rows[place]["actions"] = (rows[place]["actions"] + change) % 4
    found = problems(folder)
    assert names(found, places[0] + 1, "obs", file)
    assert names(found, places[-1] + 1, "obs", file)
    assert all(problem.startswith(file) for problem in found)


@pytest.mark.slow
@pytest.mark.parametrize("distance", [-2, -1, 1, 2])
def test_a_moved_episode_start_is_found(folder: Path, distance: int) -> None:
    with rows_of(folder, OTHER) as rows:
        start = episode_starts(rows)[1]
        rows[start]["episode_starts"] = False
        rows[start + distance]["episode_starts"] = True
    assert names(problems(folder), min(start, start + distance), "episode_starts", OTHER)


def test_a_wall_opened_in_the_info_of_an_episode_is_found(folder: Path) -> None:
    with rows_of(folder, OTHER) as rows:
        start, end = episode_starts(rows)[1:3]
        edited = dump(with_a_wall_opened(parse(rows[start]["info"])))
        for row in rows[start:end]:
            row["info"] = edited
    found = problems(folder)
    assert all(names(found, row, "obs", OTHER) for row in range(start, end))


def test_an_info_not_in_the_canonical_form_is_found(folder: Path) -> None:
    with rows_of(folder) as rows:
        end = episode_starts(rows)[1]
        for row in rows[:end]:
            row["info"] = row["info"] + "\n"
    found = problems(folder)
    assert len(found) == 1
    assert names(found, 0, "info")


def test_what_cannot_be_compared_with_its_parent_says_so(folder: Path) -> None:
    with rows_of(folder) as rows:
        rows[2]["info"] = with_a_wall_more(rows)
    first, *others = problems(folder)
    assert names([first], 2, "info")
    assert [other.partition("-")[0] for other in others] == ["random", "s0", "s0_and_g"]
    assert all(f"cannot be compared with {TRAIN}" in other for other in others)


def test_a_labyrinth_of_another_size_or_task_is_found(folder: Path, build: Build) -> None:
    other = build(folder.parent / "other", size="3x4", task="partial_observability", labyrinths=1)
    with rows_of(folder) as rows:
        start = episode_starts(rows)[2]
        rows[start:] = renamed(read_rows(other.folder / TRAIN), "train", 2)
    found = problems(folder)
    assert len([p for p in found if " row " in p and TRAIN in p]) == 1
    assert names(found, start, "info")


def route_of(rows: Rows) -> list[int]:
    return [row["actions"] for row in rows[: episode_starts(rows)[1] - 1]]


def an_action_after_the_goal(rows: Rows) -> int:
    last = episode_starts(rows)[1] - 1
    picture = rows[last]["obs"] | {"path": "train-000000-000-0009.png"}
    rows.insert(last + 1, rows[last] | {"obs": picture})
    rows[last]["actions"] = 2
    return last


def a_route_that_ends_before_the_goal(rows: Rows) -> int:
    labyrinth, route = parse(rows[0]["info"]), route_of(rows)
    rows[: len(route) + 1] = episode_rows("train", 0, labyrinth, route[:-1])
    return len(route) - 1


def a_row_less_at_the_end(rows: Rows) -> int:
    rows.pop()
    return len(rows) - 1


def steps_of_random_left_out(rows: Rows) -> int:
    labyrinth = parse(rows[0]["info"])
    own = [row for row in rows if row["info"] == rows[0]["info"]]
    rows[: len(own)] = episode_rows("random", 0, labyrinth, route_of(rows)[:1])
    return 0


def a_random_episode_cut_too_early(rows: Rows) -> int:
    labyrinth = parse(rows[0]["info"])
    own = [row for row in rows if row["info"] == rows[0]["info"]]
    rest = episode_rows("random", 0, labyrinth, [3] * 29)
    for step, row in enumerate(rest):
        row["obs"]["path"] = f"random-000000-001-{step:04d}.png"
    rows[: len(own)] = [*episode_rows("random", 0, labyrinth, [3]), *rest]
    return 1


@pytest.mark.slow
@pytest.mark.parametrize(
    ("file", "change"),
    [
        (TRAIN, an_action_after_the_goal),
        (TRAIN, a_route_that_ends_before_the_goal),
        (TRAIN, a_row_less_at_the_end),
        (RANDOM, steps_of_random_left_out),
        (RANDOM, a_random_episode_cut_too_early),
    ],
)
def test_an_episode_that_ends_where_it_may_not_is_found(
    folder: Path, file: str, change: Callable[[Rows], int]
) -> None:
    with rows_of(folder, file) as rows:
        row = change(rows)
    assert names(problems(folder), row, "actions", file)


def test_a_longer_route_with_the_right_pictures_is_found(folder: Path) -> None:
    with rows_of(folder) as rows:
        labyrinth, route = parse(rows[0]["info"]), route_of(rows)
        there_and_back = [route[0], (route[0] + 2) % 4]
        longer = episode_rows("train", 0, labyrinth, there_and_back + route)
        rows[: len(route) + 1] = longer
    found = problems(folder)
    assert len(found) == 1
    assert names(found, 0, "actions")
    assert f"routes of {len(route) + 2} moves, instead of one of {len(route)}" in found[0]


@pytest.mark.slow
def test_a_missing_and_a_repeated_route_are_found(build: Build, tmp_path: Path) -> None:
    options = {"size": "4", "solutions": "all_shortest", "open_walls": 0.6, "labyrinths": 2}
    folder = build(tmp_path, **options, random_steps=5).folder
    pristine = read_rows(folder / TRAIN)
    labyrinth = parse(pristine[0]["info"])
    assert len(shortest_routes(labyrinth)) > 1
    second = episode_starts(pristine)[1]
    with rows_of(folder) as rows:
        del rows[:second]
    assert names(problems(folder), 0, "actions")
    with rows_of(folder) as rows:
        rows[:] = [*pristine[:second], *pristine]
    assert names(problems(folder), 0, "actions")


def test_an_episode_missing_at_the_end_is_found(folder: Path) -> None:
    with rows_of(folder) as rows:
        del rows[episode_starts(rows)[2] :]
    assert "train holds 2 labyrinths, not 3" in problems(folder)


# Structures where they may not be.


def renamed(rows: Rows, split: str, number: int) -> Rows:
    return [
        row | {"obs": row["obs"] | {"path": f"{split}-{number:06d}-000-{step:04d}.png"}}
        for step, row in enumerate(rows)
    ]


def test_the_mirror_image_of_a_structure_in_another_split_is_found(folder: Path) -> None:
    train = read_rows(folder / TRAIN)
    file = "test-00000-of-00001.parquet"
    labyrinths = [parse(train[start]["info"]) for start in episode_starts(train)]
    structure = next(
        s for s in (labyrinth.structure for labyrinth in labyrinths) if s.transposed() != s
    )
    image = Labyrinth(structure.transposed(), 0, structure.cells - 1)
    with rows_of(folder, file) as rows:
        episode = episode_rows("test", 0, image, shortest_routes(image)[0])
        rows[: episode_starts(rows)[1]] = episode
    assert problems(folder) == [f"{file} row 0 info: the structure belongs to train"]


def test_a_structure_twice_in_a_split_is_found(folder: Path) -> None:
    with rows_of(folder) as rows:
        _, second, third = episode_starts(rows)
        rows[third:] = renamed(rows[:second], "train", 2)
    assert names(problems(folder), third, "info")


def test_a_structure_twice_in_a_row_is_found(folder: Path) -> None:
    with rows_of(folder) as rows:
        _, second, third = episode_starts(rows)
        rows[second:third] = renamed(rows[:second], "train", 1)
    found = problems(folder)
    assert names(found, 0, "actions")
    assert "train holds 2 labyrinths, not 3" in found


def test_a_structure_in_two_shards_of_a_split_is_found(build: Build, tmp_path: Path) -> None:
    folder = build(tmp_path, labyrinths=2, random_steps=5, cells_per_shard=9).folder
    first, second = (f"train-0000{n}-of-00002.parquet" for n in (0, 1))
    with rows_of(folder, second) as rows:
        rows[:] = renamed(read_rows(folder / first), "train", 1)
    assert f"{second} row 0 info: the structure is also in {first} row 0" in problems(folder)


@pytest.mark.slow
@pytest.mark.parametrize("split", ["random", "s0", "s0_and_g"])
def test_a_structure_that_is_not_one_of_train_is_found(folder: Path, split: str) -> None:
    test = read_rows(folder / "test-00000-of-00001.parquet")
    labyrinth = parse(test[0]["info"])
    file = f"{split}-00000-of-00001.parquet"
    with rows_of(folder, file) as rows:
        other = next(n for n, row in enumerate(rows) if row["info"] != rows[0]["info"])
        rows[:other] = episode_rows(split, 0, labyrinth, shortest_routes(labyrinth)[0])
    found = problems(folder)
    assert f"{file} row 0 info: its structure is not that of its parent in train" in found


@pytest.mark.slow
def test_a_start_or_goal_that_is_not_the_splits_is_found(folder: Path) -> None:
    labyrinth = parse(read_rows(folder / TRAIN)[0]["info"])
    moved = {
        TRAIN: Labyrinth(labyrinth.structure, 1, 8),
        "s0-00000-of-00001.parquet": Labyrinth(labyrinth.structure, 2, 0),
        "s0_and_g-00000-of-00001.parquet": Labyrinth(labyrinth.structure, 1, 8),
        # Too near to each other: at least 3 moves are asked for.
        "s0_and_g-00000-of-00001.parquet ": Labyrinth(labyrinth.structure, 4, 5),
    }
    for file, other in moved.items():
        split = file.partition("-")[0]
        with rows_of(folder, file.strip()) as rows:
            route = shortest_routes(other)[0]
            rows[: episode_starts(rows)[1]] = episode_rows(split, 0, other, route)
        assert names(problems(folder), 0, "info", file.strip())


# Pictures.


@pytest.mark.slow
def test_a_flipped_bit_anywhere_in_a_picture_is_found(folder: Path) -> None:
    picture = read_rows(folder / TRAIN)[2]["obs"]["bytes"]
    for place in [*range(0, 40, 5), *range(60, len(picture), len(picture) // 8)]:
        flipped = bytearray(picture)
        flipped[place] ^= 1 << place % 8
        with rows_of(folder) as rows:
            rows[2]["obs"]["bytes"] = bytes(flipped)
        assert names(problems(folder), 2, "obs")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("picture", "count"),
    [(saved_by_pillow(compress_level=1), 0), (with_a_wrong_pixel, 1), (saved_by_pillow("P"), 1)],
)
def test_with_other_libraries_pixels_count_and_not_bytes(
    folder: Path, picture: Callable[[Rows], bytes], count: int
) -> None:
    with rows_of(folder, OTHER) as rows:
        put(rows, 2, "bytes", picture)
    with manifest_of(folder) as content:
        content["versions"] |= FOREIGN
    found = [problem for problem in problems(folder) if " fingerprint " not in problem]
    assert [names([problem], 2, "obs", OTHER) for problem in found] == [True] * count


# Files and the manifest.


def test_a_missing_shard_is_found(folder: Path) -> None:
    (folder / "s0-00000-of-00001.parquet").unlink()
    assert problems(folder) == ["s0-00000-of-00001.parquet is missing"]


def test_a_split_that_the_manifest_lost_is_found(folder: Path) -> None:
    with manifest_of(folder) as content:
        lost = content["shards"].pop()
    found = problems(folder)
    assert f"{lost['path']} is not in the manifest" in found
    assert f"{lost['split']} holds 0 labyrinths, not 3" in found


def test_a_file_beside_the_shards_that_would_be_loaded_with_them_is_found(folder: Path) -> None:
    shutil.copy(folder / TRAIN, folder / "train-00001-of-00001.parquet")
    assert problems(folder) == ["train-00001-of-00001.parquet is not in the manifest"]


@pytest.mark.parametrize("damage", ["truncated", "garbage", "empty", "a folder", "no footer"])
def test_a_damaged_file_is_found(folder: Path, damage: str) -> None:
    path = folder / TRAIN
    content = path.read_bytes()
    path.unlink()
    if damage == "a folder":
        path.mkdir()
    else:
        damaged = {
            "truncated": content[: len(content) // 2],
            "garbage": bytes(range(256)) * 40,
            "empty": b"",
            "no footer": content[:-8] + bytes(8),
        }
        path.write_bytes(damaged[damage])
    first, *others = problems(folder)
    assert first.startswith(f"{TRAIN} cannot be read: ")
    assert [other.partition("-")[0] for other in others] == ["random", "s0", "s0_and_g"]
    assert all(f"cannot be compared with {TRAIN}" in other for other in others)


@pytest.mark.slow
def test_a_flipped_bit_anywhere_in_a_file_is_found(folder: Path) -> None:
    path = folder / TRAIN
    content = path.read_bytes()
    for place in range(3, len(content), len(content) // 40):
        flipped = bytearray(content)
        flipped[place] ^= 1 << place % 8
        path.write_bytes(flipped)
        assert any(problem.startswith(TRAIN) for problem in problems(folder))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("rows", 1),
        ("episodes", 99),
        ("labyrinths", 2),
        ("longest", 3),
        ("cut", 1),
        ("bytes", 5),
        ("sha256", "0" * 64),
        ("fingerprint", "0" * 64),
    ],
)
def test_a_manifest_that_says_something_else_of_a_shard_is_found(
    folder: Path, name: str, value: Any
) -> None:
    with manifest_of(folder) as content:
        assert content["shards"][0][name] != value
        content["shards"][0][name] = value
    found = problems(folder)
    assert any(TRAIN in problem and name in problem for problem in found)


@pytest.mark.slow
def test_a_dataset_of_another_configuration_is_found(folder: Path) -> None:
    for name, value in [
        ("labyrinths", 4),
        ("solutions", "all"),
        ("random_steps", 31),
        ("height", 4),
        ("task", "icy_floor"),
        ("buckets", [20, 40, 40]),
    ]:
        with manifest_of(folder) as content:
            before = content["config"][name]
            content["config"][name] = value
        assert problems(folder) != []
        with manifest_of(folder) as content:
            content["config"][name] = before
    assert problems(folder) == []


# Content that means harm.


def changed_table(folder: Path, change: Callable[[pa.Table], pa.Table]) -> None:
    path = folder / TRAIN
    pq.write_table(change(pq.read_table(path)), path)
    with manifest_of(folder) as content:
        content["shards"][0] |= {"sha256": file_sha256(path), "bytes": path.stat().st_size}


def retyped(name: str, type_: pa.DataType) -> Callable[[pa.Table], pa.Table]:
    def change(table: pa.Table) -> pa.Table:
        place = table.schema.get_field_index(name)
        return table.set_column(place, name, pa.nulls(len(table), type_))

    return change


@pytest.mark.slow
@pytest.mark.parametrize(
    "change",
    [
        *(retyped(name, pa.string()) for name in ("obs", "actions", "rewards", "episode_starts")),
        retyped("obs", pa.binary()),
        retyped("obs", pa.list_(pa.uint8())),
        retyped("actions", pa.int32()),
        retyped("rewards", pa.float64()),
        retyped("info", pa.binary()),
        retyped("info", pa.list_(pa.string())),
        *(lambda table, name=column.name: table.drop_columns(name) for column in COLUMNS),
        lambda table: table.append_column("extra", pa.nulls(len(table))),
        lambda table: table.rename_columns(["obs", "action", "rewards", "episode_starts", "info"]),
        lambda table: table.select(["info", "obs", "actions", "rewards", "episode_starts"]),
    ],
)
def test_other_columns_are_found(folder: Path, change: Callable[[pa.Table], pa.Table]) -> None:
    changed_table(folder, change)
    assert f"{TRAIN}: its columns are not the five" in problems(folder)


@pytest.mark.slow
@pytest.mark.parametrize("column", [column.name for column in COLUMNS])
@pytest.mark.parametrize("row", [0, 3])
def test_a_field_that_holds_nothing_is_found(folder: Path, column: str, row: int) -> None:
    rows = read_rows(folder / TRAIN)
    rows[row][column] = None
    changed_table(folder, lambda _: pa.Table.from_pylist(rows, schema=arrow_schema()))
    assert names(problems(folder), row, column)


@pytest.mark.parametrize("part", ["bytes", "path"])
def test_half_a_picture_field_is_found(folder: Path, part: str) -> None:
    rows = read_rows(folder / TRAIN)
    rows[3]["obs"][part] = None
    changed_table(folder, lambda _: pa.Table.from_pylist(rows, schema=arrow_schema()))
    assert names(problems(folder), 3, "obs")


def test_a_file_without_rows_is_found(folder: Path) -> None:
    changed_table(folder, lambda table: table.slice(0, 0))
    assert "train holds 3 labyrinths, not 3" not in problems(folder)
    assert f"{TRAIN}: rows 0, but the manifest says" in "\n".join(problems(folder))


def test_text_that_is_not_utf8_is_found(folder: Path) -> None:
    def change(table: pa.Table) -> pa.Table:
        raw = pa.array([b"\xff\xfe"] * len(table), pa.binary()).view(pa.string())
        return table.set_column(
            table.schema.get_field_index("info"), arrow_schema().field("info"), raw
        )

    changed_table(folder, change)
    assert any(problem.startswith(f"{TRAIN} cannot be read") for problem in problems(folder))


def wide_open(side: int) -> Labyrinth:
    cells = range(side * side)
    passages = [(c, c + 1) for c in cells if (c + 1) % side]
    passages += [(c, c + side) for c in cells if c + side < side * side]
    return Labyrinth(Structure.from_passages(side, side, passages), 0, side * side - 1)


@pytest.mark.slow
@pytest.mark.parametrize(
    "info",
    [
        *("", "nonsense", "labyrinth:\nend\n", "\0", "\x1b[2J", "{'a': 1}", "key_and_lock: True"),
        "a" * 2_000_000,
        "\n" * 2_000_000,
        "labyrinth:\n" + "-" * 2_000_001 + "\n",
        '"""' * 500_001,
        "(" * 500_000,
        dump(wide_open(300)),
        "__import__('pathlib').Path('evaluated').touch()",
        "!!python/object/apply:pathlib.Path.touch [evaluated]",
        "${oc.env:HOME}",
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
@pytest.mark.parametrize("name", HOSTILE_PICTURES)
def test_a_hostile_picture_is_found(folder: Path, name: str) -> None:
    rows = read_rows(folder / TRAIN)
    rows[2]["obs"]["bytes"] = HOSTILE_PICTURES[name]
    changed_table(folder, lambda _: pa.Table.from_pylist(rows, schema=arrow_schema()))
    assert names(problems(folder), 2, "obs")


# The stage.


def test_the_stage_raises_all_it_found_and_shows_the_first(
    folder: Path, make_run: Callable[..., Run]
) -> None:
    with rows_of(folder, RANDOM) as rows:
        for row in rows:
            row["obs"]["path"] = "x"
    run = make_run(folder.parent, stages=["validate"], labyrinths=3)
    assert run.folder == folder
    with pytest.raises(validation.ValidationError) as caught:
        validation.run(run)
    assert caught.value.problems == problems(folder)
    assert len(caught.value.problems) == len(rows)
    lines = str(caught.value).splitlines()
    assert len(lines) == validation.PROBLEMS_SHOWN + 2
    assert lines[-1] == f"  and {len(rows) - validation.PROBLEMS_SHOWN} more"


def test_the_stage_needs_a_dataset(tmp_path: Path, make_run: Callable[..., Run]) -> None:
    with pytest.raises(DatasetError, match="holds no finished dataset"):
        validation.run(make_run(tmp_path, stages=["validate"]))

"""Validation finds each thing that can be wrong with a dataset, and nothing in a right one."""

from __future__ import annotations

import io
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from PIL import Image
from support.making import Run
from support.tampering import (
    MOVED,
    OTHER,
    RANDOM,
    S0,
    TEST,
    TRAIN,
    Rows,
    episode_rows,
    episode_starts,
    manifest_of,
    names,
    problems,
    read_rows,
    rows_of,
    with_a_wall_opened,
)

from labyrinth_core.language import dump, parse
from labyrinth_core.world import Labyrinth, Solver, Structure, Task
from pipeline.generation import check as validation

Build = Callable[..., Run]
Change = Callable[[Rows, Path], str]
"""Changes the rows of a file in a folder; returns how the problem that is found begins."""

FOREIGN = {"zlib": "0.0.0"}
"""Versions that say the bytes of pictures may be others."""


# Nothing wrong.


@pytest.mark.parametrize(
    "options",
    [
        {"size": "2x4", "labyrinths": 1, "solutions": "all"},
        {"size": "4x3", "labyrinths": 3, "task": "key_and_door", "solutions": "all"},
        {"size": "3x4", "labyrinths": 3, "task": "icy_floor", "solutions": "all_shortest"},
        {"size": "4", "labyrinths": 3, "solutions": "all", "solutions_limit": 2},
        {"size": "3", "labyrinths": 3, "random_steps": 1, "buckets": (60, 30, 10)},
    ],
    ids=str,
)
def test_what_was_built_has_no_problems(
    build: Build, tmp_path: Path, options: dict[str, Any]
) -> None:
    assert problems(build(tmp_path, **{"random_steps": 40} | options).folder) == []


# Rows that are wrong, though file and manifest agree.


def put(row: int, column: str, value: Any, named: str = "") -> Change:
    """Return a change of a field of the first episode, whose last row is -1.

    Args:
        row: The row.
        column: The column, or a part of `obs`.
        value: What it holds then, or a function of the rows that returns this.
        named: The row and column that validation names, if they are others.
    """

    def change(rows: Rows, _: Path) -> str:
        place = row if row >= 0 else episode_starts(rows)[1] + row
        is_picture = column in ("path", "bytes")
        holder = rows[place]["obs"] if is_picture else rows[place]
        holder[column] = value(rows) if callable(value) else value
        field = "obs" if is_picture else column
        return f"row {named or f'{place} {field}'}: "

    return change


def with_a_wall_more(rows: Rows) -> str:
    return dump(with_a_wall_opened(parse(rows[2]["info"])))


def saved_by_pillow(
    mode: str = "RGB", kind: str = "PNG", **options: Any
) -> Callable[[Rows], bytes]:
    def save(rows: Rows) -> bytes:
        file = io.BytesIO()
        picture = Image.open(io.BytesIO(rows[2]["obs"]["bytes"])).convert(mode)
        picture.save(file, kind, **options)
        return file.getvalue()

    return save


def with_a_wrong_pixel(rows: Rows) -> bytes:
    picture = Image.open(io.BytesIO(rows[2]["obs"]["bytes"]))
    picture.putpixel((300, 300), (1, 2, 3))
    file = io.BytesIO()
    picture.save(file, "PNG")
    return file.getvalue()


def route_of(rows: Rows) -> list[int]:
    return [row["actions"] for row in rows[: episode_starts(rows)[1] - 1]]


def renamed(rows: Rows, split: str, number: int, episode: int = 0) -> Rows:
    name = f"{split}-{number:06d}-{episode:03d}"
    return [
        row | {"obs": row["obs"] | {"path": f"{name}-{step:04d}.png"}}
        for step, row in enumerate(rows)
    ]


def replace_first(rows: Rows, split: str, labyrinth: Labyrinth, route: list[int]) -> None:
    """Let the first labyrinth of a split be another one, with an episode that is right."""
    own = [row for row in rows if row["info"] == rows[0]["info"]]
    rows[: len(own)] = episode_rows(split, 0, labyrinth, route)


def a_moved_episode_start(distance: int) -> Change:
    def change(rows: Rows, _: Path) -> str:
        start = episode_starts(rows)[1]
        rows[start]["episode_starts"] = False
        rows[start + distance]["episode_starts"] = True
        return f"row {min(start, start + distance)} episode_starts: "

    return change


def a_wall_opened_in_the_text(rows: Rows, _: Path) -> str:
    start, end = episode_starts(rows)[1:3]
    edited = dump(with_a_wall_opened(parse(rows[start]["info"])))
    for row in rows[start:end]:
        row["info"] = edited
    return f"row {end - 1} obs: "


def a_text_not_in_the_canonical_form(rows: Rows, _: Path) -> str:
    for row in rows[: episode_starts(rows)[1]]:
        row["info"] = row["info"] + "\n"
    return "row 0 info: not in the canonical form"


def a_labyrinth_of_another_size(rows: Rows, _: Path) -> str:
    its = Labyrinth(Structure.without_walls(3, 4), 0, 11)
    replace_first(rows, "train", its, Solver(its).shortest_routes()[0])
    return "row 0 info: a labyrinth of 3x4"


def a_labyrinth_of_another_task(rows: Rows, _: Path) -> str:
    its = Labyrinth(parse(rows[0]["info"]).structure, 0, 8, Task.PARTIAL_OBSERVABILITY)
    replace_first(rows, "train", its, Solver(its).shortest_routes()[0])
    return "row 0 info: a labyrinth of 3x3, partial_observability"


def a_route_that_ends_before_the_goal(rows: Rows, _: Path) -> str:
    *route, last = route_of(rows)
    replace_first(rows, "train", parse(rows[0]["info"]), route)
    return f"row {len(route)} actions: -1, not {last}"


def a_row_less_at_the_end(rows: Rows, _: Path) -> str:
    rows.pop()
    start = episode_starts(rows)[-1]
    return f"row {start} actions: {len(rows) - start} rows, not {len(rows) - start + 1}"


def a_longer_route_with_the_right_pictures(rows: Rows, _: Path) -> str:
    route = route_of(rows)
    there_and_back = [route[0], (route[0] + 2) % 4]
    replace_first(rows, "train", parse(rows[0]["info"]), there_and_back + route)
    moves = len(route)
    return f"row 0 actions: {moves + 3} rows, not {moves + 1}"


def the_second_labyrinth_in_place_of_the_first(split: str) -> Change:
    def change(rows: Rows, _: Path) -> str:
        its = parse(next(row["info"] for row in rows if row["info"] != rows[0]["info"]))
        replace_first(rows, split, its, Solver(its).shortest_routes()[0])
        return "row 0 info: its structure is not that of its parent in train"

    return change


def a_labyrinth_more_than_there_are_parents(rows: Rows, _: Path) -> str:
    start = len(rows)
    rows += renamed(rows[: episode_starts(rows)[1]], "s0", 3)
    return f"row {start} info: a labyrinth that is not made from any of train"


def ends_too_near_to_each_other(rows: Rows, _: Path) -> str:
    its = Labyrinth(parse(rows[0]["info"]).structure, 4, 5)
    replace_first(rows, "s0_and_g", its, Solver(its).shortest_routes()[0])
    return "row 0 info: start and goal are less than 3 moves apart"


def the_mirror_image_of_a_structure_of_train(rows: Rows, folder: Path) -> str:
    texts = {row["info"] for row in read_rows(folder / TRAIN)}
    images = {its: its.transposed() for its in (parse(text).structure for text in texts)}
    image = next(image for its, image in images.items() if its != image)
    its = Labyrinth(image, 0, image.cells - 1)
    replace_first(rows, "test", its, Solver(its).shortest_routes()[0])
    return "row 0 info: the structure belongs to train"


def a_structure_twice_in_a_split(rows: Rows, _: Path) -> str:
    _, second, third = episode_starts(rows)
    rows[third:] = renamed(rows[:second], "train", 2)
    return f"row {third} info: the structure is also in row 0"


ALONE: list[tuple[str, Change]] = [
    *((OTHER, put(1, "rewards", value)) for value in (1.0, 0.0, float("nan"))),
    (OTHER, put(-1, "rewards", 1.0)),
    (OTHER, put(2, "info", with_a_wall_more)),
    (OTHER, put(2, "path", "\n" * 1_000)),
    (OTHER, put(2, "bytes", lambda rows: rows[1]["obs"]["bytes"])),
    (OTHER, put(2, "bytes", with_a_wrong_pixel)),
    (OTHER, put(2, "bytes", saved_by_pillow(compress_level=1))),
    (TRAIN, a_text_not_in_the_canonical_form),
    (TEST, the_mirror_image_of_a_structure_of_train),
]
"""The file and the change of which validation names one problem and no other."""

WITH_OTHERS: list[tuple[str, Change]] = [
    *((OTHER, put(1, "actions", value)) for value in (4, -(2**63))),
    (OTHER, put(1, "actions", -1)),
    (OTHER, put(2, "episode_starts", True)),
    (OTHER, put(0, "episode_starts", False)),
    *((OTHER, put(2, "bytes", saved_by_pillow(mode))) for mode in ("RGBA", "P")),
    *((OTHER, a_moved_episode_start(distance)) for distance in (-1, 1)),
    (OTHER, a_wall_opened_in_the_text),
    (TRAIN, a_labyrinth_of_another_size),
    (TRAIN, a_labyrinth_of_another_task),
    (TRAIN, a_longer_route_with_the_right_pictures),
    (TRAIN, a_route_that_ends_before_the_goal),
    (TRAIN, a_row_less_at_the_end),
    (TRAIN, a_structure_twice_in_a_split),
    (MOVED, ends_too_near_to_each_other),
    (S0, a_labyrinth_more_than_there_are_parents),
    (RANDOM, the_second_labyrinth_in_place_of_the_first("random")),
    (S0, the_second_labyrinth_in_place_of_the_first("s0")),
]
"""The file and the change of which validation names a problem, and what follows from it."""


@pytest.mark.slow
@pytest.mark.parametrize(("file", "change"), [*ALONE, *WITH_OTHERS])
def test_rows_that_are_wrong_are_found(folder: Path, file: str, change: Change) -> None:
    with rows_of(folder, file) as rows:
        problem = f"{file} {change(rows, folder)}"
    found = problems(folder)
    assert any(each.startswith(problem) for each in found), found
    assert len(found) == 1 or (file, change) in WITH_OTHERS


@pytest.mark.slow
@pytest.mark.parametrize("file", [TRAIN, RANDOM])
def test_a_swapped_action_is_found(folder: Path, file: str) -> None:
    with rows_of(folder, file) as rows:
        places = [n for n, row in enumerate(rows) if row["actions"] >= 0]
        for place in (places[0], places[-1]):
            rows[place]["actions"] = (rows[place]["actions"] + 1) % 4
    found = problems(folder)
    assert names(found, places[0], "actions", file)
    assert names(found, places[-1], "actions", file)
    assert all(problem.startswith(file) for problem in found)


# Structures where they may not be.


def test_a_structure_in_two_shards_of_a_split_is_found(build: Build, tmp_path: Path) -> None:
    folder = build(tmp_path, labyrinths=2, random_steps=5, cells_per_shard=9).folder
    first, second = (f"train-0000{n}-of-00002.parquet" for n in (0, 1))
    with rows_of(folder, second) as rows:
        rows[:] = renamed(read_rows(folder / first), "train", 1)
    assert f"{second} row 0 info: the structure is also in {first} row 0" in problems(folder)


# Pictures.


@pytest.mark.slow
@pytest.mark.parametrize(
    ("picture", "count"),
    [
        (saved_by_pillow(compress_level=1), 0),
        (with_a_wrong_pixel, 1),
        (saved_by_pillow("P"), 1),
        (saved_by_pillow(kind="BMP"), 1),
    ],
)
def test_with_other_libraries_pixels_count_and_not_bytes(
    folder: Path, picture: Callable[[Rows], bytes], count: int
) -> None:
    with rows_of(folder, OTHER) as rows:
        put(2, "bytes", picture)(rows, folder)
    with manifest_of(folder) as content:
        content["versions"] |= FOREIGN
    found = [problem for problem in problems(folder) if " fingerprint " not in problem]
    assert [names([problem], 2, "obs", OTHER) for problem in found] == [True] * count


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

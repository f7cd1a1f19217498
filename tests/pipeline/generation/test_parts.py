"""Builds in parts, which several processes make in one folder, and a last run puts together."""

from __future__ import annotations

import random
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from support.making import Run
from support.tampering import content_of

from labyrinth_core.errors import DatasetError
from labyrinth_core.storage import LocalFile
from pipeline.config import ConfigError

Build = Callable[..., Run]

SHARDS: dict[str, Any] = {"size": "4", "labyrinths": 10, "random_steps": 20}
SHARDS |= {"cells_per_shard": 16 * 4, "cells_per_chunk": (16 * 12, 16 * 8)}
"""Three shards a split, of structures from several chunks."""


@pytest.fixture(scope="module")
def whole(build: Build, tmp_path_factory: pytest.TempPathFactory) -> Run:
    """The dataset as one process makes it."""
    return build(tmp_path_factory.mktemp("whole") / "labyrinth", **SHARDS)


def written(data_dir: Path) -> dict[str, int]:
    """Return when each shard and each chunk of an unfinished build was written."""
    building = data_dir / ".4x4.building"
    found = [*building.rglob("*.parquet"), *building.glob("*.chunk")]
    return {path.name: path.stat().st_mtime_ns for path in found}


@pytest.mark.slow
@pytest.mark.parametrize("parts", [1, 2, 4, 40])
def test_parts_put_together_are_the_dataset_that_one_process_makes(
    build: Build, tmp_path: Path, whole: Run, parts: int
) -> None:
    order = list(range(1, parts + 1))
    random.Random(parts).shuffle(order)
    there: dict[str, int] = {}
    for part in order:
        build(tmp_path, **SHARDS, part=f"{part}/{parts}")
        now = written(tmp_path)
        assert there.items() <= now.items(), "what is there is not made again"
        there = now
    assert not (tmp_path / "4x4").exists()
    run = build(tmp_path, **SHARDS)
    assert content_of(tmp_path) == content_of(whole.data_dir)
    shards = {path.name: path.stat().st_mtime_ns for path in run.folder.glob("*-of-*.parquet")}
    assert shards.items() <= there.items()
    build(tmp_path, **SHARDS, part="1/4")
    assert content_of(tmp_path) == content_of(whole.data_dir)


@pytest.mark.slow
def test_a_part_removes_what_its_killed_process_left_and_nothing_of_other_parts(
    build: Build, tmp_path: Path
) -> None:
    build(tmp_path, **SHARDS, part="1/2")
    building = tmp_path / ".4x4.building"
    names = (f"train-0000{number}-of-00003.parquet" for number in (0, 1))
    own, other = (LocalFile(building / name).temporary() for name in names)
    for path in (own, other):
        path.write_bytes(b"half of it")
    build(tmp_path, **SHARDS, part="2/2")
    assert (own.exists(), other.exists()) == (False, True)


@pytest.mark.slow
def test_parts_that_are_missing_are_named_with_what_makes_them(
    build: Build, tmp_path: Path, whole: Run
) -> None:
    for part in (1, 4):
        build(tmp_path, **SHARDS, part=f"{part}/4")
    with pytest.raises(DatasetError) as caught:
        build(tmp_path, **SHARDS)
    assert str(caught.value) == (
        f"{tmp_path / '4x4'}: 8 of 18 shards missing, those of part 2/4, 3/4; "
        "this command with part=2/4 makes the first of them"
    )
    for part in (2, 3):
        build(tmp_path, **SHARDS, part=f"{part}/4")
    next((tmp_path / ".4x4.building").glob("s0-00001-of-*.shard")).unlink()
    with pytest.raises(
        DatasetError, match="1 of 18 shards missing, those of part 1/4; this command"
    ):
        build(tmp_path, **SHARDS)
    build(tmp_path, **SHARDS, part="1/4")
    assert content_of(build(tmp_path, **SHARDS).data_dir) == content_of(whole.data_dir)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"labyrinths": 11, "part": "2/4"}, "labyrinths=10, not 11:"),
        ({"seed": 3, "solutions": "all", "part": "2/4"}, "solutions=shortest, not all; seed=0, "),
        ({"part": "2/3"}, "parts=4, not 3:"),
        ({"labyrinths": 11}, "labyrinths=10, not 11:"),
    ],
    ids=str,
)
def test_parts_with_other_options_in_one_folder_are_refused(
    build: Build, tmp_path: Path, options: dict[str, Any], words: str
) -> None:
    build(tmp_path, **SHARDS, part="1/4")
    before = written(tmp_path)
    with pytest.raises(DatasetError, match=f"holds parts of a build with {words}"):
        build(tmp_path, **SHARDS | options)
    assert written(tmp_path) == before
    build(tmp_path, **SHARDS | {"labyrinths": 2}, overwrite=True)
    assert not (tmp_path / ".4x4.building").exists()


@pytest.mark.slow
def test_a_build_goes_on_in_another_number_of_parts(
    build: Build, tmp_path: Path, whole: Run
) -> None:
    build(tmp_path, **SHARDS, part="1/4")
    for part in ("1/2", "2/2"):
        build(tmp_path, **SHARDS, part=part, overwrite=True)
    assert content_of(build(tmp_path, **SHARDS).data_dir) == content_of(whole.data_dir)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ("5/4", "give a part from 1 to 4, such as 1/4"),
        ("x", "give the part and the number of parts, such as 3/64"),
        ("1/0", "give the part and the number of parts, such as 3/64"),
    ],
)
def test_what_is_no_part_is_refused(
    make_run: Callable[..., Run], tmp_path: Path, given: str, words: str
) -> None:
    with pytest.raises(ConfigError, match=f"^part={given}: {words}$"):
        make_run(tmp_path, part=given)


def test_only_builds_have_parts(make_run: Callable[..., Run], tmp_path: Path) -> None:
    run = make_run(tmp_path, part="1/2", stages=["build", "validate", "analyse"])
    assert run.options.stages == ("build",)

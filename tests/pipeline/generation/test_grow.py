"""Datasets that grow: a larger one keeps the shards that a smaller one has filled."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from support.crashing import CrashError, before_each_shard
from support.making import Run, SplitsConfig
from support.tampering import content_of, manifest_of

from labyrinth_core.data import Manifest
from labyrinth_core.errors import DatasetError

Build = Callable[..., Run]

OF_FOUR: dict[str, Any] = {"size": "4", "random_steps": 20, "cells_per_shard": 16 * 4}
"""Four labyrinths in a shard."""
LONGER: dict[str, Any] = OF_FOUR | {"labyrinths": 17, "grow": True}
CHUNKS = {"cells_per_chunk": (16 * 20, 16 * 8)}


@pytest.fixture(scope="module")
def short(build: Build, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Ten labyrinths a split; copy it before you change it."""
    return build(tmp_path_factory.mktemp("short"), **OF_FOUR, labyrinths=10).data_dir


@pytest.fixture(scope="module")
def long(build: Build, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build(tmp_path_factory.mktemp("long"), **OF_FOUR, labyrinths=17).data_dir


def test_a_longer_dataset_keeps_the_shards_that_were_full(
    build: Build, tmp_path: Path, short: Path, long: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data_dir = Path(shutil.copytree(short, tmp_path / "data"))
    build(data_dir, **LONGER)
    printed = " ".join(capsys.readouterr().out.split())
    assert "4x4 grows: 12 of 30 shards stay." in printed
    assert content_of(data_dir) == content_of(long)
    before, after = (
        {shard.sha256 for shard in Manifest.read(each / "4x4").shards} for each in (short, long)
    )
    assert len(before & after) == 12


@pytest.mark.parametrize(
    "shifts", [("recoloured",), ("g", "test_g", "kruskal"), ("open", "test_new_routes")], ids=str
)
def test_a_dataset_gets_shifts_and_keeps_all_its_shards(
    build: Build,
    tmp_path: Path,
    short: Path,
    shifts: tuple[str, ...],
    capsys: pytest.CaptureFixture[str],
) -> None:
    new = build(tmp_path / "new", **OF_FOUR, labyrinths=10, shifts=shifts)
    data_dir = Path(shutil.copytree(short, tmp_path / "data"))
    build(data_dir, **OF_FOUR, labyrinths=10, shifts=shifts, grow=True)
    assert "4x4 grows: 18 of " in " ".join(capsys.readouterr().out.split())
    assert content_of(data_dir / "4x4") == content_of(new.folder)


@pytest.mark.parametrize("options", [{"labyrinths": 11}, {"labyrinths": 10, "shifts": ("g",)}])
def test_a_finished_dataset_grows_only_where_that_is_asked_for(
    build: Build, tmp_path: Path, short: Path, options: dict[str, Any]
) -> None:
    there = content_of(short)
    fingerprint = Manifest.read(short / "4x4").fingerprint
    folders = {"run_dir": str(tmp_path / "runs"), "results_dir": str(tmp_path / "results")}
    for given in ({}, {"part": "1/2"}):
        with pytest.raises(DatasetError, match=r"grow=true .* another data_dir$"):
            build(short, **OF_FOUR, **options, **folders, **given)
    for name, of in {
        "runs/4x4/bc-seed0/run.json": fingerprint,
        "runs/4x4/bc-seed1/run.json": "0" * 64,
        "results/submissions/4x4/mine.json": fingerprint,
    }.items():
        path = tmp_path / name
        path.parent.mkdir(parents=True)
        path.write_text(f'{{"fingerprint": "{of}"}}')
    words = r"submissions/4x4/mine.json, \S*bc-seed0/run.json would refer to"
    with pytest.raises(DatasetError, match=words):
        build(short, **OF_FOUR, **options, **folders)
    assert content_of(short) == there


@pytest.mark.slow
@pytest.mark.parametrize(
    "options",
    [
        {"shifts": ("g", "test_g")},
        {"task": "icy_floor"},
        {"solutions": "all", "goals": "varied"},
        CHUNKS,
    ],
    ids=str,
)
def test_datasets_of_every_kind_grow_to_the_bytes_that_a_new_one_has(
    build: Build, tmp_path: Path, options: dict[str, Any]
) -> None:
    for labyrinths in (6, 10, 16):
        grown = build(tmp_path / "grown", **OF_FOUR | options, labyrinths=labyrinths, grow=True)
    new = build(tmp_path / "new", **OF_FOUR | options, labyrinths=16)
    assert content_of(grown.data_dir) == content_of(new.data_dir)


def damage_shard(folder: Path) -> None:
    (folder / "train-00000-of-00003.parquet").write_bytes(b"half")
    (folder / "s0-00001-of-00003.parquet").unlink()


def change_versions(folder: Path) -> None:
    with manifest_of(folder) as content:
        content["versions"]["numpy"] = "0.1"


@pytest.mark.slow
@pytest.mark.parametrize("happens", [damage_shard, change_versions])
def test_a_shard_that_cannot_be_kept_is_made(
    build: Build, tmp_path: Path, short: Path, long: Path, happens: Callable[[Path], None]
) -> None:
    data_dir = Path(shutil.copytree(short, tmp_path / "data"))
    happens(data_dir / "4x4")
    build(data_dir, **LONGER)
    assert content_of(data_dir) == content_of(long)


@pytest.mark.slow
def test_the_shorter_dataset_stays_until_the_longer_one_is_whole(
    build: Build, tmp_path: Path, short: Path, long: Path
) -> None:
    data_dir = Path(shutil.copytree(short, tmp_path / "data"))
    left = iter(range(20))

    def stop() -> None:
        if next(left, None) is None:
            raise CrashError

    with before_each_shard(stop), pytest.raises(CrashError):
        build(data_dir, **LONGER)
    assert content_of(data_dir / "4x4") == content_of(short / "4x4")
    for part in ("2/2", "1/2"):
        build(data_dir, **LONGER, part=part)
    build(data_dir, **LONGER)
    assert content_of(data_dir) == content_of(long)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("before", "options", "words"),
    [
        (
            {},
            {"labyrinths": 9},
            r"not labyrinths=9: to extend it, .* labyrinths=10 'shifts=\[\]'",
        ),
        (
            {"shifts": ("g",)},
            {"shifts": ("kruskal",)},
            r"shifts=\[g\], not shifts=\[kruskal\]: to extend it, .* 'shifts=\[g,kruskal\]'",
        ),
        ({}, {"labyrinths": 11, "seed": 1}, "labyrinths=10, not labyrinths=11; seed=0, not"),
        # Validation and test depend on all of train then.
        ({"splits": SplitsConfig(6)}, {"labyrinths": 60}, "labyrinths that are not in"),
        ({"shifts": ("open",)}, {"labyrinths": 60}, "labyrinths that are not in"),
    ],
)
def test_what_would_lose_labyrinths_is_refused(
    build: Build, tmp_path: Path, before: dict[str, Any], options: dict[str, Any], words: str
) -> None:
    folder = build(tmp_path, **OF_FOUR | {"labyrinths": 10} | before).folder
    there = content_of(folder)
    with pytest.raises(DatasetError, match=words):
        build(tmp_path, **OF_FOUR | before | options, grow=True)
    assert content_of(folder) == there
    assert Manifest.read(build(tmp_path, **OF_FOUR | before | options, overwrite=True).folder)

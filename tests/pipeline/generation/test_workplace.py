"""Two runs into one folder, and what a run that ended in the wrong moment has left."""

from __future__ import annotations

import errno
import os
import shutil
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import filelock
import pytest
from support.crashing import CrashError, before_each_shard, crash
from support.making import Run
from support.tampering import content_of, identities

from labyrinth_core.data import Manifest
from labyrinth_core.errors import DatasetError
from labyrinth_core.storage import LocalFile

Build = Callable[..., Run]


# Two runs at once.


@pytest.mark.slow
def test_the_second_of_two_runs_waits_says_so_and_finds_all_done(
    build: Build, tmp_path: Path, small_dataset: Run, capsys: pytest.CaptureFixture[str]
) -> None:
    second = threading.Thread(target=lambda: build(tmp_path))

    def begin() -> None:
        if not second.ident:
            second.start()
            second.join(0.5)
            assert second.is_alive()

    with before_each_shard(begin):
        build(tmp_path)
    second.join()
    printed = " ".join(capsys.readouterr().out.split())
    assert "waiting for another process that works on " in printed
    assert printed.count("is complete already") == 1
    assert content_of(tmp_path) == content_of(small_dataset.data_dir)


def test_where_there_are_no_locks_no_build_waits(
    build: Build, tmp_path: Path, small_dataset: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    def no_locks(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSYS, "this file system has no locks")

    monkeypatch.setattr(filelock.FileLock, "acquire", no_locks)
    assert content_of(build(tmp_path).data_dir) == content_of(small_dataset.data_dir)


# What was left.


def test_an_old_dataset_that_was_being_replaced_is_put_back_or_removed(
    build: Build, tmp_path: Path, small_dataset: Run
) -> None:
    build(tmp_path)
    made = identities(tmp_path / "3x3")
    folder = tmp_path / "3x3"
    replaced = LocalFile(folder).temporary(".replaced")
    folder.rename(replaced)  # The crash came between the two renames.
    build(tmp_path)
    assert content_of(tmp_path) == content_of(small_dataset.data_dir)
    shutil.copytree(folder, replaced)  # The crash came after them.
    build(tmp_path)
    assert content_of(tmp_path) == content_of(small_dataset.data_dir)
    assert identities(folder) == made  # Nothing was written again.


@pytest.mark.slow
@pytest.mark.parametrize(
    "moment", ["before the move", "after the move", Manifest.FILE, "README.md"]
)
def test_a_crash_costs_no_shard_and_leaves_nothing_in_the_end(
    build: Build, tmp_path: Path, small_dataset: Run, moment: str
) -> None:
    with crash(moment):
        build(tmp_path)
    moved = moment in ("after the move", "README.md")
    assert (tmp_path / "3x3" / Manifest.FILE).exists() == moved
    written = [] if moment.endswith("the move") else [f".{moment}."]
    assert [path.name[: len(moment) + 2] for path in tmp_path.rglob("*.tmp")] == written
    made = identities(tmp_path / ("3x3" if moved else ".3x3.building/shards"))
    build(tmp_path)
    assert content_of(tmp_path) == content_of(small_dataset.data_dir)
    assert identities(tmp_path / "3x3") == made  # Nothing was written again.


def test_a_crash_while_the_building_is_cleared_leaves_nothing_of_it_in_the_end(
    build: Build, tmp_path: Path, small_dataset: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    unlink, cleared = Path.unlink, []

    def crash_midway(path: Path, **options: Any) -> None:
        if path.parent.name == ".3x3.building":
            cleared.append(path)
            if len(cleared) == 5:
                raise CrashError
        unlink(path, **options)

    with monkeypatch.context() as patch:
        patch.setattr(Path, "unlink", crash_midway)
        with pytest.raises(CrashError):
            build(tmp_path)
    assert list(tmp_path.glob(".3x3.building/*.shard"))
    build(tmp_path)
    assert content_of(tmp_path) == content_of(small_dataset.data_dir)


def test_all_is_on_the_disk_before_it_becomes_a_dataset(
    build: Build, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    synced: set[int] = set()
    fsync, rename = os.fsync, Path.replace
    moved: list[Path] = []

    def note(descriptor: int) -> None:
        fsync(descriptor)
        synced.add(os.fstat(descriptor).st_ino)

    def check(path: Path, target: Path) -> Path:
        if path.is_dir():
            files = [path, *path.iterdir()]
            assert len(files) == 1 + 6 + 1 + 1
            assert {each.stat().st_ino for each in files} <= synced
            moved.append(target)
        return rename(path, target)

    monkeypatch.setattr(os, "fsync", note)
    monkeypatch.setattr(Path, "replace", check)
    folder = build(tmp_path).folder
    assert moved == [folder]
    assert folder.parent.stat().st_ino in synced


def test_a_run_that_took_the_place_over_is_noticed(build: Build, tmp_path: Path) -> None:
    config = tmp_path / ".3x3.building" / "config.json"
    with (
        before_each_shard(lambda: config.write_text("{}")),
        pytest.raises(DatasetError, match="another run has begun another dataset"),
    ):
        build(tmp_path)
    assert not (tmp_path / "3x3").exists()

"""A finished dataset with damaged files, and a person's files beside those of a dataset."""

from __future__ import annotations

import os
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from support.crashing import before_each_shard
from support.making import Run, perform
from support.tampering import (
    TRAIN,
    content_of,
    cut_short,
    folder_behind_link,
    identities,
    linked,
    manifest_of,
)

from labyrinth_core.data import Manifest
from labyrinth_core.errors import DatasetError
from pipeline.machinery import leave

Build = Callable[..., Run]

TEST = "test-00000-of-00001.parquet"


@pytest.fixture
def folder(small_dataset: Run, tmp_path: Path) -> Path:
    """A finished dataset that may be changed."""
    shutil.copytree(small_dataset.data_dir, tmp_path / "data")
    return tmp_path / "data" / "3x3"


def change(path: Path) -> None:
    path.write_bytes(path.read_bytes()[::-1])


DAMAGES = (cut_short, change, Path.unlink)


@pytest.mark.slow
@pytest.mark.parametrize("damage", DAMAGES, ids=lambda each: each.__name__)
def test_a_build_makes_damaged_shards_anew_and_no_others(
    build: Build,
    folder: Path,
    small_dataset: Run,
    damage: Callable[[Path], None],
    capsys: pytest.CaptureFixture[str],
) -> None:
    for name in (TRAIN, TEST):
        damage(folder / name)
    before = identities(folder)
    build(folder.parent)
    printed = " ".join(capsys.readouterr().out.split())
    after = identities(folder)
    assert {name for name in after if before.get(name) != after[name]} == {TRAIN, TEST}
    assert f"{folder} is complete again; repaired: " in printed
    assert TRAIN in printed
    assert TEST in printed
    assert content_of(folder.parent) == content_of(small_dataset.data_dir)
    build(folder.parent)
    assert f"{folder} is complete already." in " ".join(capsys.readouterr().out.split())


def test_a_shard_that_was_changed_and_has_an_old_time_is_made_anew(
    build: Build, folder: Path
) -> None:
    before = content_of(folder)
    change(folder / TRAIN)
    for path in folder.iterdir():
        os.utime(path, (1, 2 if path.name == Manifest.FILE else 1))
    build(folder.parent)
    assert content_of(folder) == before


def test_a_shard_that_comes_out_otherwise_is_not_put_into_its_place(
    build: Build, folder: Path
) -> None:
    (folder / TRAIN).unlink()
    with manifest_of(folder) as content:  # As another version would have made it.
        content["shards"][0]["sha256"] = "0" * 64
    before = content_of(folder.parent)
    with pytest.raises(DatasetError, match=r"train-.* cannot be made again .*overwrite=true"):
        build(folder.parent)
    assert content_of(folder.parent) == before
    assert not (folder.parent / ".3x3.building").exists()


def test_a_shard_that_this_version_would_not_make_is_named(build: Build, folder: Path) -> None:
    (folder / TRAIN).unlink()
    with pytest.raises(DatasetError, match=r"train-00000-of-00001\.parquet cannot be made again"):
        build(folder.parent, cells_per_shard=9)  # Eight shards a split.


# Links.


@pytest.mark.parametrize("target", ["mine", "nowhere"])
@pytest.mark.parametrize("name", [TEST, Manifest.TABLE])
def test_mending_replaces_a_link_and_not_its_target(
    build: Build, folder: Path, tmp_path: Path, name: str, target: str
) -> None:
    before = content_of(folder)
    (tmp_path / "mine").write_text("years of work")
    (folder / name).unlink()
    (folder / name).symlink_to(tmp_path / target)
    build(folder.parent)
    assert content_of(folder) == before
    assert not (folder / name).is_symlink()
    assert (tmp_path / "mine").read_text() == "years of work"
    assert not (tmp_path / "nowhere").exists()


@pytest.mark.slow
@pytest.mark.parametrize("options", [{}, {"seed": 1, "overwrite": True}, {"grow": True}])
def test_a_dataset_of_links_into_a_store_is_used_and_the_store_never_changes(
    build: Build, folder: Path, tmp_path: Path, options: dict[str, Any]
) -> None:
    data_dir = folder.parent
    leave(data_dir / "report", {"index.html": b"1"})
    store = linked(data_dir, tmp_path / "store")
    if "grow" in options:
        options = options | {"labyrinths": 10}
    run = build(data_dir, **options)
    perform("analyse", run)
    leave(data_dir / "report", {"index.html": b"2"})
    assert content_of(tmp_path / "store") == store
    build(data_dir, size="2x3", labyrinths=1)
    assert content_of(tmp_path / "store") == store
    assert (data_dir / "README.md").is_symlink() is False


def test_nothing_is_written_through_a_linked_working_folder(
    build: Build, folder: Path, tmp_path: Path
) -> None:
    elsewhere = folder_behind_link(folder.parent / ".3x3.building", tmp_path)
    with pytest.raises(DatasetError, match="building is a link, and nothing is written through it"):
        build(folder.parent, seed=1, overwrite=True)
    assert list(elsewhere.iterdir()) == []


# Files of a person.


OTHERS = (
    *("notes.txt", "train.parquet", "my-00001-of-2.parquet", "figures/"),
    *("data-00000-of-00009.parquet", "train-00000-of-00009.parquet", f"{TEST}/", ".x.tmp"),
    *("labyrinths.parquet/", "analysis.json", ".manifest.json.0123456789ab.tmp"),
)


@pytest.mark.parametrize("name", OTHERS)
def test_overwriting_is_refused_while_a_person_has_files_in_the_folder(
    build: Build, folder: Path, name: str
) -> None:
    (folder / name).unlink(missing_ok=True)
    (folder / name).mkdir() if name.endswith("/") else (folder / name).write_text("years of work")
    before = content_of(folder.parent)
    reason = rf"3x3 holds {re.escape(name.strip('/'))}, .*move it elsewhere"
    with pytest.raises(DatasetError, match=reason) as caught:
        build(folder.parent, seed=1, overwrite=True)
    assert "\n" not in str(caught.value)
    assert content_of(folder.parent) == before
    assert (folder / name).exists()


@pytest.mark.parametrize(
    "litter", [".DS_Store", "Thumbs.db", ".ipynb_checkpoints/notes.txt", "@eaDir/train/SYNO@.png"]
)
def test_litter_stops_no_build(build: Build, tmp_path: Path, litter: str) -> None:
    for number, place in enumerate(("3x3", ".3x3.building", "3x3")):
        (tmp_path / place / litter).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / place / litter).write_text("left by a system")
        folder = build(tmp_path, seed=number, overwrite=number > 0).folder
        assert Manifest.read(folder).config.seed == number
        assert not (folder / litter).exists()


@pytest.mark.parametrize(
    "place", ["3x3/train-00000-of-00001.parquet", "3x3/labyrinths.parquet", ".3x3.building/x.json"]
)
def test_files_of_a_person_where_there_is_no_dataset_stop_a_build(
    build: Build, tmp_path: Path, place: str
) -> None:
    (tmp_path / place).parent.mkdir()
    (tmp_path / place).write_text("years of work")
    with pytest.raises(DatasetError, match=f"{Path(place).parent} holds {Path(place).name}, which"):
        build(tmp_path, overwrite=True)
    assert content_of(tmp_path) == {place: b"years of work"}


@pytest.mark.slow
@pytest.mark.parametrize("name", [".3x3.x.tmp", ".README.md.0123456789ab.tmp", ".3x3.replaced"])
def test_files_called_like_what_a_killed_build_leaves_are_kept(
    build: Build, folder: Path, name: str
) -> None:
    (folder.parent / name).write_text("years of work")
    build(folder.parent, seed=1, overwrite=True)
    assert (folder.parent / name).read_text() == "years of work"
    assert Manifest.read(folder).config.seed == 1


def test_what_was_analysed_of_a_dataset_is_replaced_with_it(
    build: Build, folder: Path, make_run: Build
) -> None:
    perform("analyse", make_run(folder.parent, stages=["analyse"]))
    build(folder.parent, seed=1, overwrite=True)
    assert not (folder / "analysis.json").exists()
    perform("analyse", make_run(folder.parent, stages=["analyse"]))
    (folder / "analysis.json").write_text("years of work")
    with pytest.raises(DatasetError, match=r"3x3 holds analysis\.json, which would be lost"):
        build(folder.parent, seed=2, overwrite=True)
    assert (folder / "analysis.json").read_text() == "years of work"


def test_notes_that_came_during_the_build_are_not_lost_and_no_shard_is(
    build: Build, folder: Path
) -> None:
    notes = folder / "notes.txt"
    with (
        before_each_shard(lambda: notes.write_text("years of work")),
        pytest.raises(DatasetError, match=r"3x3 holds notes\.txt"),
    ):
        build(folder.parent, seed=1, overwrite=True)
    assert notes.read_text() == "years of work"
    notes.unlink()
    made = identities(folder.parent / ".3x3.building" / "shards")
    build(folder.parent, seed=1, overwrite=True)
    assert Manifest.read(folder).config.seed == 1
    assert made.items() <= identities(folder).items()  # Nothing was written again.


def test_a_file_in_the_place_of_the_folder_is_left_alone(build: Build, tmp_path: Path) -> None:
    (tmp_path / "3x3").write_text("years of work")
    with pytest.raises(DatasetError, match="3x3 is a file"):
        build(tmp_path, overwrite=True)
    assert content_of(tmp_path) == {"3x3": b"years of work"}


def test_a_folder_that_a_link_leads_to_is_replaced_and_the_link_stays(
    build: Build, folder: Path, tmp_path: Path
) -> None:
    elsewhere = tmp_path / "elsewhere" / "large"
    elsewhere.parent.mkdir()
    folder.rename(elsewhere)
    folder.symlink_to(elsewhere)
    for seed in (1, 2):
        build(folder.parent, seed=seed, overwrite=True)
        assert folder.is_symlink()
        assert Manifest.read(folder).config.seed == seed
        assert {path.name for path in folder.parent.iterdir()} == {"3x3", "README.md"}
        assert [path.name for path in elsewhere.parent.iterdir()] == ["large"]


@pytest.mark.parametrize("content", [b"", b'{"format": 2', bytes(range(256))])
def test_a_damaged_manifest_is_replaced_only_when_that_is_asked_for(
    build: Build, folder: Path, content: bytes
) -> None:
    before = content_of(folder)
    (folder / Manifest.FILE).write_bytes(content)
    with pytest.raises(DatasetError, match=r"cannot be read: .*; build it again with overwrite="):
        build(folder.parent)
    build(folder.parent, overwrite=True)
    assert content_of(folder) == before


def test_a_dataset_under_another_name_is_replaced_only_when_that_is_asked_for(
    build: Build, folder: Path
) -> None:
    before = content_of(folder)
    build(folder.parent, size="4x4")
    (folder.parent / "4x4").rename(folder.parent / "other")
    shutil.rmtree(folder)
    (folder.parent / "other").rename(folder)
    with pytest.raises(DatasetError, match=r"holds a dataset with height=4, not height=3; .*"):
        build(folder.parent)
    build(folder.parent, overwrite=True)
    assert content_of(folder) == before

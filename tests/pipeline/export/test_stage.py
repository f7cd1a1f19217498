"""Exports are whole or absent, and a mistake is told in one line.

That damage, crashes, links and files of a person do no harm holds of all artifacts, and is shown in
tests/pipeline/machinery/test_artifact.py; here is shown that an export is one.
"""

from __future__ import annotations

import json
import shutil
import signal
import sys
from collections.abc import Callable
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pytest
from support.commands import run
from support.exporting import export, split_of
from support.making import Run
from support.tampering import content_of

from labyrinth_core import hub
from labyrinth_core.data import Manifest
from labyrinth_core.errors import DatasetError
from labyrinth_core.storage import File
from pipeline.config import ConfigError, ExportOptions, Job
from pipeline.export import stage

FORMATS = tuple(ExportOptions.FORMATS)
RECORD = ExportOptions.RECORD


@pytest.mark.slow
def test_all_splits_are_exported_unless_some_are_named(small_dataset: Run, tmp_path):
    folder = export(small_dataset, tmp_path, "lerobot")
    splits = [f"{split}-v0" for split in small_dataset.dataset.splits]
    assert sorted(path.name for path in folder.iterdir()) == sorted(splits)


@pytest.mark.slow
@pytest.mark.parametrize("format_", FORMATS)
def test_a_finished_export_is_kept_and_made_alike_where_it_is_missing_or_damaged(
    small_dataset: Run, tmp_path, capsys, format_
):
    splits = "train", "test", "s0"
    folder = export(small_dataset, tmp_path, format_, *splits)
    before = content_of(folder)
    shutil.rmtree(folder / "test-v0")
    (folder / "s0-v0" / RECORD).unlink()
    kept = (folder / "train-v0" / RECORD).stat().st_ino
    export(small_dataset, tmp_path, format_, *splits)
    printed = " ".join(capsys.readouterr().out.split())
    assert "train-v0 is there already" in printed
    assert f"s0-v0 is made again, because missing: {RECORD}." in printed
    assert (folder / "train-v0" / RECORD).stat().st_ino == kept
    assert content_of(folder) == before

    (folder / "s0-v0" / RECORD).write_text("{")
    shutil.rmtree(folder / "test-v0")
    reason = f"s0-v0 holds {RECORD}, damaged or changed since it was made: give overwrite"
    with pytest.raises(DatasetError, match=reason):
        export(small_dataset, tmp_path, format_, *splits)
    assert not (folder / "test-v0").exists()
    export(small_dataset, tmp_path, format_, *splits, overwrite=True)
    assert content_of(folder) == before


def test_an_export_with_other_options_is_replaced_only_when_that_is_asked_for(
    small_dataset: Run, tmp_path
):
    folder = export(small_dataset, tmp_path, "lerobot", "train")
    before = content_of(folder)
    reason = "train-v0 is made with image_size=40, not 8: choose another .*, or give overwrite=true"
    with pytest.raises(DatasetError, match=reason):
        export(small_dataset, tmp_path, "lerobot", "train", image_size=8)
    assert content_of(folder) == before
    export(small_dataset, tmp_path, "lerobot", "train", image_size=8, overwrite=True)
    assert json.loads((folder / "train-v0" / RECORD).read_bytes())["image_size"] == 8
    assert [path.name for path in folder.iterdir()] == ["train-v0"]


def test_what_is_no_export_is_never_replaced_and_stops_the_stage_before_the_first_split(
    small_dataset: Run, tmp_path
):
    theirs = tmp_path / "lerobot" / "labyrinth" / "3x3" / "test-v0" / RECORD
    theirs.parent.mkdir(parents=True)
    theirs.write_text("mine")
    message = f"test-v0 holds {RECORD}, which would be lost: move it elsewhere, or choose"
    with pytest.raises(DatasetError, match=message):
        export(small_dataset, tmp_path, "lerobot", overwrite=True)
    assert content_of(tmp_path) == {f"lerobot/labyrinth/3x3/test-v0/{RECORD}": b"mine"}


def test_litter_in_an_export_stops_nothing(small_dataset: Run, tmp_path, capsys):
    made = export(small_dataset, tmp_path, "lerobot", "train") / "train-v0"
    litter = made / "cache-0123456789abcdef.arrow"  # Of `datasets`.
    litter.touch()
    export(small_dataset, tmp_path, "lerobot", "train", "test")
    assert "train-v0 is there already" in capsys.readouterr().out
    assert litter.exists()
    export(small_dataset, tmp_path, "lerobot", "train", image_size=8, overwrite=True)
    assert json.loads((made / RECORD).read_bytes())["image_size"] == 8


def test_an_export_may_lie_in_a_folder_whose_name_has_a_colon(
    small_dataset: Run, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    shutil.copytree(small_dataset.data_dir, "da:ta")
    for format_ in FORMATS:
        made = export(small_dataset, Path("a:b"), format_, "test", dataset="da:ta")
        assert (made / "test-v0" / RECORD).is_file()


@contextmanager
def files_of_at_most(size: int):
    """Let every file of this process end at so many bytes, as on a full disk."""
    resource = pytest.importorskip("resource")  # Not on Windows.
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.mark.slow
@pytest.mark.parametrize("format_", FORMATS)
@pytest.mark.parametrize("size", [300, 2_000])
def test_a_full_disk_is_told_in_one_line_and_leaves_nothing(
    small_dataset: Run, tmp_path, monkeypatch, capfd, format_, size
):
    monkeypatch.chdir(tmp_path)
    if format_ == "minari":  # Nothing is left to HDF5 that it has no room for.
        usage = shutil.disk_usage(tmp_path)._replace(free=100 * size)
        monkeypatch.setattr(shutil, "disk_usage", lambda _: usage)
        size = pytest.importorskip("resource").RLIM_INFINITY
    reason = "train-v0 cannot be written: .*(File too large|No space left on device)"
    with files_of_at_most(size), pytest.raises(DatasetError, match=reason) as caught:
        export(small_dataset, Path("exports"), format_, "train")
    assert "\n" not in str(caught.value)
    assert capfd.readouterr().err == ""
    assert list(tmp_path.iterdir()) == []


MISTAKES = [
    ({"format_": "hdf4"}, r"export.format=hdf4: choose one of \[minari, imitation, lerobot\]"),
    ({"format_": ""}, r"export.format=: choose one of \[minari"),
    ({"splits": ["train", "eval"]}, r"export.splits=\[train, eval\]: choose from \[train, vali"),
    ({"image_size": 0}, "export.image_size=0: give a whole number from 1 to 600"),
    ({"revision": "main"}, "revision=main: .* is a folder, which has no revisions"),
    ({"folder": "s3://bucket/exports"}, "export.folder=s3://bucket/exports: give a folder on this"),
]


@pytest.mark.parametrize(("options", "message"), MISTAKES)
def test_a_mistake_is_told_in_one_line(small_dataset: Run, tmp_path, monkeypatch, options, message):
    monkeypatch.chdir(tmp_path)
    given = {"folder": tmp_path / "exports", "format_": "lerobot", "splits": ()} | options
    place, splits = (given.pop("folder"), given.pop("format_")), given.pop("splits")
    with pytest.raises(ConfigError, match=message):
        export(small_dataset, *place, *splits, **given)
    assert list(tmp_path.iterdir()) == []


def test_a_library_that_is_missing_is_named_before_anything_is_read(
    small_dataset: Run, tmp_path, monkeypatch
):
    monkeypatch.setitem(sys.modules, "h5py", None)  # As if it were not installed.
    message = r"minari needs h5py: pip install 'labyrinth-datasets\[minari\]'"
    with pytest.raises(ConfigError, match=message):
        export(small_dataset, tmp_path, "minari")
    assert list(tmp_path.iterdir()) == []


def test_a_table_of_other_labyrinths_is_refused_and_leaves_nothing(small_dataset: Run, tmp_path):
    shutil.copytree(small_dataset.folder, tmp_path / "theirs" / "3x3")
    path = tmp_path / "theirs" / "3x3" / Manifest.TABLE
    table = pq.read_table(path)
    pq.write_table(table.take([*range(1, len(table)), 0]), path)
    content = json.loads((path.parent / Manifest.FILE).read_bytes())
    content["labyrinths"] = {"bytes": path.stat().st_size, "sha256": File(path).sha256()}
    (path.parent / Manifest.FILE).write_text(json.dumps(content), encoding="utf-8")
    with pytest.raises(DatasetError, match="the table of labyrinths does not match its episodes"):
        export(small_dataset, tmp_path / "exports", "lerobot", dataset=str(tmp_path / "theirs"))
    assert [path.name for path in tmp_path.iterdir()] == ["theirs"]


def test_splits_of_a_dataset_that_is_replaced_meanwhile_are_not_mixed(build, tmp_path, monkeypatch):
    run = build(tmp_path / "data", labyrinths=4)
    write = stage._export

    def replaced(*split):
        write(*split)
        build(tmp_path / "data", labyrinths=4, seed=1, overwrite=True)

    monkeypatch.setattr(stage, "_export", replaced)
    with pytest.raises(DatasetError, match="3x3 was replaced or grew while it was read"):
        export(run, tmp_path / "exports", "lerobot", "train", "test")
    assert [path.name for path in tmp_path.glob("exports/lerobot/labyrinth/3x3/*")] == ["train-v0"]


def test_a_dataset_on_the_hub_is_exported_like_its_folder_with_the_licence_of_its_card(
    build, tmp_path, monkeypatch
):
    run, asked = build(tmp_path / "data"), []
    (run.data_dir / "README.md").write_text("---\nlicense: [mit, cc0-1.0]\nconfigs: []\n---\n")
    own = export(run, tmp_path / "own", "lerobot", "test")
    assert json.loads((own / "test-v0" / RECORD).read_bytes())["licence"] == "mit, cc0-1.0"

    def download(_repo_id, _repo_type, _commit, names):
        asked.extend(names)
        cache = tmp_path / "cache"
        for name in names:
            (cache / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(run.data_dir / name, cache / name)
        return cache

    monkeypatch.setattr(hub, "commit_of", lambda *_: "0" * 40)
    monkeypatch.setattr(hub, "download", download)
    found = export(run, tmp_path / "hub", "lerobot", "test", dataset="user/labyrinth")
    assert content_of(found) == content_of(own)
    shard = "3x3/{}-00000-of-00001.parquet".format
    assert {"3x3/labyrinths.parquet", "README.md", shard("test")} <= set(asked)
    assert shard("train") not in asked


def test_a_drive_without_locks_is_told_what_to_set(
    small_dataset: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refused(*_: Any) -> None:
        reason = "(unable to lock file, errno = 37, error message = 'No locks available')"
        raise OSError(37, f"Unable to synchronously open file {reason}")

    monkeypatch.setattr("pipeline.export.minari.write", refused)
    with pytest.raises(DatasetError, match=r"No locks .*; .* set HDF5_USE_FILE_LOCKING=FALSE in"):
        export(small_dataset, tmp_path, "minari", "test")


@pytest.mark.parametrize(
    ("solutions", "limit", "demonstrator"),
    [
        ("all", 2, "every simple route, at most 2 per labyrinth"),
        ("all", 1000, "every simple route"),
        ("all_shortest", 1, "every shortest route, at most 1 per labyrinth"),
        ("shortest", 1, "a shortest route"),
    ],
)
def test_who_demonstrates_is_said_with_the_limit_of_routes_where_it_was_reached(
    build: Callable[..., Run], tmp_path: Path, solutions: str, limit: int, demonstrator: str
) -> None:
    options = {"solutions": solutions, "solutions_limit": limit}
    run = build(tmp_path, size="4x4", labyrinths=5, **options)
    assert split_of(run, "train").demonstrator == demonstrator
    assert split_of(run, "random").demonstrator == "a uniformly random policy"


@pytest.mark.slow
def test_an_export_lies_beside_the_options_that_make_it_again(small_dataset: Run, tmp_path):
    made, again = tmp_path / "made", tmp_path / "again"
    for folder in (made, again):
        folder.mkdir()
    asked = ["size=3", f"data_dir={small_dataset.data_dir}", "stages=export", "export=imitation"]
    assert run(made, *asked, "export.splits=test").returncode == 0
    (config,) = made.rglob(Job.CONFIG)
    assert f"  {Job.CONFIG}\n" in (config.parent / "SHA256SUMS").read_text()
    done = run(again, "--config-dir", str(config.parent), "--config-name", "config")
    assert (done.returncode, done.stderr) == (0, "")
    assert content_of(again) == content_of(made)

"""Datasets in object stores: whole or not there, the bytes of a local build, and how it goes on."""

from __future__ import annotations

import errno
import shutil
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any
from uuid import uuid4

import fsspec
import numpy as np
import pytest
from support.making import Run, RunConfig, resolve
from support.s3_server import S3Server, serving

from labyrinth_core.data.errors import DatasetError
from labyrinth_core.data.load import load_transitions
from labyrinth_core.data.manifest import MANIFEST, Manifest
from labyrinth_core.data.storage import (
    File,
    LocalFile,
    RemotePath,
    folder_at,
)
from pipeline.config.errors import ConfigError
from pipeline.generation import build as generation
from pipeline.generation import check as validation
from pipeline.machinery.folders import new_file
from pipeline.release import card
from pipeline.release.options import PublishOptions

pytestmark = pytest.mark.slow

Build = Callable[..., Run]

TRAIN = "train-00000-of-00001.parquet"


@pytest.fixture
def memory() -> Iterator[str]:
    """The URL of a folder in memory, whose name looks like a pattern."""
    name = uuid4().hex
    yield f"memory://{name}/run [5x5]*"
    filesystem = fsspec.filesystem("memory")
    if filesystem.exists(f"/{name}"):
        filesystem.rm(f"/{name}", recursive=True)


@pytest.fixture(scope="module")
def server() -> Iterator[S3Server]:
    with serving() as (server, address), pytest.MonkeyPatch.context() as patch:
        patch.setenv("AWS_ENDPOINT_URL", address)
        patch.setenv("AWS_ACCESS_KEY_ID", "nobody")
        patch.setenv("AWS_SECRET_ACCESS_KEY", "nothing")
        patch.setenv("AWS_DEFAULT_REGION", "us-east-1")
        yield server


@pytest.fixture
def bucket(server: S3Server) -> Iterator[str]:
    """The URL of a folder in a new bucket, whose name looks like a pattern."""
    name = uuid4().hex
    fsspec.filesystem("s3", use_listings_cache=False).mkdir(name)
    server.requests.clear()
    yield f"s3://{name}/run [5x5]*"
    server.fault = lambda _method, _path: False


def content_of(folder: Path | RemotePath) -> dict[str, bytes]:
    """Return the content of all files of a folder, and of those in it."""
    files = [*folder.glob("*"), *folder.glob("*/*"), *folder.glob(".*"), *folder.glob(".*/*")]
    prefix = len(str(folder)) + 1
    return {str(p)[prefix:].replace("\\", "/"): p.read_bytes() for p in files if p.is_file()}


# Files.


@pytest.fixture(params=["local", "memory", "s3"])
def folder(request: pytest.FixtureRequest, tmp_path: Path) -> Path | RemotePath:
    if request.param == "local":
        return tmp_path
    return folder_at(request.getfixturevalue({"memory": "memory", "s3": "bucket"}[request.param]))


def test_a_folder_is_used_alike_wherever_it_is(folder: Path | RemotePath, tmp_path: Path) -> None:
    deeper = folder / "a" / "b"
    assert not deeper.exists()
    assert not list(folder.glob("*/*"))
    with pytest.raises(FileNotFoundError):
        (deeper / "one.txt").read_bytes()
    deeper.mkdir(parents=True, exist_ok=True)
    File(deeper / "one.txt").write_bytes(b"old")
    File(deeper / "one.txt").write_bytes(b"new")
    with new_file(deeper / "two.txt", tmp_path) as local:
        local.write_bytes(b"2")
        assert not (deeper / "two.txt").exists()
    assert [path.name for path in sorted(deeper.iterdir(), key=str)] == ["one.txt", "two.txt"]
    assert [str(path) for path in (folder / "a").glob("*/one*")] == [str(deeper / "one.txt")]
    assert (deeper / "one.txt").read_text(encoding="utf-8") == "new"
    assert (deeper / "one.txt").parent == deeper
    assert deeper.is_dir()
    assert (deeper / "one.txt").is_file()
    assert not deeper.is_file()
    with (deeper / "one.txt").open("rb") as file:
        assert file.read(2) == b"ne"
    with File(deeper / "two.txt").local_copy() as local:
        assert local.read_bytes() == b"2"
    (deeper / "one.txt").unlink()
    (deeper / "one.txt").unlink(missing_ok=True)
    assert [path.name for path in deeper.iterdir()] == ["two.txt"]


def test_a_file_that_is_not_finished_is_not_there(
    folder: Path | RemotePath, tmp_path: Path
) -> None:
    def write_half() -> None:
        with new_file(folder / "shard", tmp_path) as local:
            local.write_bytes(b"half of it")
            raise RuntimeError

    with pytest.raises(RuntimeError):
        write_half()
    assert not list(folder.glob("*"))


@pytest.mark.parametrize("write", ["write_bytes", "new_file", "replacing"])
def test_a_link_is_replaced_itself_and_a_folder_never(tmp_path: Path, write: str) -> None:
    def put(path: Path) -> None:
        if write == "write_bytes":
            File(path).write_bytes(b"new")
            return
        with (
            new_file(path, tmp_path)
            if write == "new_file"
            else LocalFile(path).replacing() as local
        ):
            local.write_bytes(b"new")

    target, folder = tmp_path / "target", tmp_path / "folder"
    target.write_bytes(b"old")
    folder.mkdir()
    for place in (target, folder, tmp_path / "nowhere"):
        link = tmp_path / f"to-{place.name}"
        link.symlink_to(place)
        put(link)
        assert not link.is_symlink()
        assert link.read_bytes() == b"new"
    with pytest.raises(FileExistsError, match=r"is not a regular file.*folder"):
        put(folder)
    assert target.read_bytes() == b"old"
    assert list(folder.iterdir()) == []
    assert len(list(tmp_path.iterdir())) == 5


def test_a_link_that_a_user_names_for_output_leads_to_its_target(tmp_path: Path) -> None:
    link, folder = tmp_path / "link", tmp_path / "folder"
    link.symlink_to("target")
    folder.symlink_to(tmp_path)
    File(LocalFile(link).target()).write_bytes(b"new")
    assert link.is_symlink()
    assert (tmp_path / "target").read_bytes() == b"new"
    assert LocalFile(tmp_path / "other").target() == tmp_path / "other"
    with pytest.raises(FileExistsError, match="is not a regular file"):
        LocalFile(folder).target()


def test_an_error_of_a_full_disk_names_the_file_that_is_written(tmp_path: Path) -> None:
    path = tmp_path / "a.parquet"
    for writing in (LocalFile(path).replacing(), new_file(path, tmp_path)):
        with pytest.raises(OSError, match=r"No space left on device: '.*a\.parquet'"), writing:
            raise OSError(errno.ENOSPC, "No space left on device")
        assert list(tmp_path.iterdir()) == []


def test_an_error_of_a_temporary_file_names_the_file_that_is_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(path: Path, _: Path) -> None:
        raise PermissionError(errno.EPERM, "Operation not permitted", str(path))

    with monkeypatch.context() as patch:
        patch.setattr(Path, "replace", refuse)
        with pytest.raises(PermissionError) as refused:
            File(tmp_path / "y.png").write_bytes(b"")
    assert refused.value.filename == str(tmp_path / "y.png")
    path = tmp_path / "nowhere" / "x.png"
    with pytest.raises(FileNotFoundError) as caught:
        File(path).write_bytes(b"")
    assert caught.value.filename == str(path)


def test_only_names_with_their_own_hash_are_those_of_temporary_files(tmp_path: Path) -> None:
    path = tmp_path / "README.md"
    made = LocalFile(path).temporary()
    for name in (made.name, f".README.md.{'0' * 12}.{'0' * 8}.tmp", ".README.md.tmp", "x.tmp"):
        (tmp_path / name).touch()
    assert LocalFile.temporaries(tmp_path, [path.name]) == [made]
    assert LocalFile.temporaries(tmp_path, ["README"]) == []
    assert LocalFile.temporaries(tmp_path, [path.name], ".replaced") == []


class FailingStore(fsspec.AbstractFileSystem):
    """A store that fails with an error of its own."""

    protocol = "failing"

    def cat_file(self, path: str, **_: Any) -> bytes:
        raise RuntimeError(f"no\ncredentials for {path}")


def test_what_a_store_raises_becomes_one_os_error_with_the_url() -> None:
    fsspec.register_implementation("failing", FailingStore, clobber=True)
    with pytest.raises(OSError, match="RuntimeError: no credentials") as caught:
        RemotePath("failing://labyrinth/x").read_bytes()
    assert caught.value.filename == "failing://labyrinth/x"


def test_a_file_url_is_a_local_folder(tmp_path: Path) -> None:
    assert folder_at(f"file://{tmp_path}") == tmp_path


@pytest.mark.parametrize(
    ("options", "parts"),
    [
        ({"data_dir": "nosuch://a/b"}, ["data_dir=nosuch://a/b", "nosuch"]),
        ({"data_dir": "gs://a/b"}, ["data_dir=gs://a/b", "missing", "install gcsfs"]),
        (
            {
                "data_dir": "memory://a",
                "stages": ["publish"],
                "publish": PublishOptions(repo_id="a/b", version="1.0.0"),
            },
            ["memory://a", "publish need a local folder"],
        ),
    ],
    ids=["unknown", "missing", "publish"],
)
def test_a_place_that_cannot_be_used_is_answered_with_one_line(
    options: dict[str, Any], parts: list[str]
) -> None:
    config = RunConfig(**{"stages": ["build"]} | options)
    with pytest.raises(ConfigError) as caught:
        resolve(config)
    assert all(part in str(caught.value) for part in parts), caught.value
    assert "\n" not in str(caught.value)


# Datasets.


@pytest.mark.parametrize("store", ["memory", "bucket"])
def test_a_dataset_in_a_store_is_the_local_one_and_is_used_like_it(
    request: pytest.FixtureRequest, build: Build, store: str, small_dataset: Run, tmp_path: Path
) -> None:
    url = request.getfixturevalue(store)
    run = build(url)
    assert content_of(run.data_dir) == content_of(small_dataset.data_dir)
    validation.run(run)
    card.run(run)
    shutil.copytree(small_dataset.data_dir, tmp_path, dirs_exist_ok=True)
    local = replace(small_dataset, data_dir=tmp_path)
    card.run(local)
    assert content_of(run.data_dir) == content_of(local.data_dir)
    here, there = (load_transitions(p, "3x3", cache_dir=False) for p in (local.data_dir, url))
    assert np.array_equal(here.observations, there.observations)
    assert build(url).data_dir == run.data_dir  # Complete already.


def test_damaged_and_missing_shards_in_a_store_are_made_anew(
    build: Build, memory: str, small_dataset: Run
) -> None:
    folder = build(memory).folder
    test, random = (folder / f"{name}-00000-of-00001.parquet" for name in ("test", "random"))
    test.unlink()
    File(folder / TRAIN).write_bytes(b"PAR1")
    File(random).write_bytes(random.read_bytes()[::-1])
    assert content_of(build(memory).folder) == content_of(small_dataset.folder)


def test_files_of_a_person_in_a_store_stop_the_build_that_would_replace_them(
    build: Build, memory: str
) -> None:
    folder = build(memory, labyrinths=1).folder
    File(folder / "notes.parquet").write_bytes(b"years of work")
    with pytest.raises(DatasetError, match=r"holds notes\.parquet"):
        build(memory, overwrite=True)
    assert (folder / "notes.parquet").read_bytes() == b"years of work"
    assert Manifest.read(folder).config.labyrinths == 1


def test_in_a_store_a_dataset_that_is_being_replaced_is_none_until_the_new_one_is_whole(
    build: Build, server: S3Server, bucket: str, small_dataset: Run
) -> None:
    build(bucket, labyrinths=2, random_steps=5, cells_per_shard=9)
    with pytest.raises(DatasetError, match="labyrinths=2, not labyrinths=8"):
        build(bucket)
    server.fault = denied(".parquet", 0)
    with pytest.raises((DatasetError, OSError), match=f"{bucket}|quota"):
        build(bucket, overwrite=True)
    assert not (folder_at(bucket) / "3x3" / MANIFEST).exists()
    server.fault = lambda _method, _path: False
    assert content_of(build(bucket).data_dir) == content_of(small_dataset.data_dir)


def denied(part: str, times: int) -> Callable[[str, str], bool]:
    """Return a fault for uploads of names with `part`, after `times` of them went well."""
    seen: list[str] = []

    def fault(method: str, path: str) -> bool:
        if method == "PUT" and part in path:
            seen.append(path)
        return method == "PUT" and part in path and len(seen) > times

    return fault


@pytest.mark.parametrize(
    ("part", "times"),
    [("config.json", 0), (".parquet", 3), (".shard", 3), (MANIFEST, 0)],
)
def test_an_upload_that_fails_leaves_no_dataset_and_the_next_run_makes_what_is_not_whole(
    build: Build, server: S3Server, bucket: str, small_dataset: Run, part: str, times: int
) -> None:
    server.fault = denied(part, times)
    with pytest.raises((DatasetError, OSError), match=f"{bucket}|quota"):
        build(bucket)
    folder = folder_at(bucket) / "3x3"
    assert not (folder / MANIFEST).exists()
    finished = {path.name for path in (folder.parent / ".3x3.building").glob("*.shard")}
    server.fault = lambda _method, _path: False
    damaged = {TRAIN.replace(".parquet", ".shard")} if part == MANIFEST else set()
    if damaged:
        File(folder / TRAIN).write_bytes((folder / TRAIN).read_bytes()[:-1] + b"?")  # As long.
    server.requests.clear()
    run = build(bucket)
    assert content_of(run.data_dir) == content_of(small_dataset.data_dir)
    uploads = [path.rpartition("/")[2] for method, path in server.requests if method == "PUT"]
    made_again = {path.replace(".parquet", ".shard") for path in uploads if ".parquet" in path}
    assert made_again & finished == damaged
    manifest_at = uploads.index(MANIFEST)
    assert not any(".parquet" in path for path in uploads[manifest_at:])


def test_a_shard_that_did_not_arrive_keeps_the_manifest_away(
    build: Build, memory: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    make_shard = generation.make_shard

    def lose(job: generation.ShardJob) -> Any:
        shard = make_shard(job)
        if job.split == "s0":
            job.path.unlink()
        return shard

    monkeypatch.setattr(generation, "make_shard", lose)
    with pytest.raises(DatasetError, match="has no s0-00000-of-00001"):
        build(memory)
    assert not (folder_at(memory) / "3x3" / MANIFEST).exists()

"""Datasets in object stores: whole or not there, the bytes of a local build, and how it goes on."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from support.making import Run
from support.s3_server import S3Server, bucket, content_of, memory, server

from labyrinth_core import load_transitions
from labyrinth_core.data import Manifest
from labyrinth_core.errors import DatasetError
from labyrinth_core.storage import File, folder_at
from pipeline.generation import build as generation
from pipeline.generation import check as validation

__all__ = ["bucket", "memory", "server"]

pytestmark = pytest.mark.slow

Build = Callable[..., Run]

TRAIN = "train-00000-of-00001.parquet"


@pytest.mark.parametrize("store", ["memory", "bucket"])
def test_a_dataset_in_a_store_is_the_local_one_and_is_used_like_it(
    request: pytest.FixtureRequest, build: Build, store: str, small_dataset: Run
) -> None:
    url = request.getfixturevalue(store)
    run = build(url)
    assert content_of(run.data_dir) == content_of(small_dataset.data_dir)
    validation.run(run)
    local = small_dataset.data_dir
    here, there = (load_transitions(place, "3x3", cache_dir=False) for place in (local, url))
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
    assert not (folder_at(bucket) / "3x3" / Manifest.FILE).exists()
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
    [("config.json", 0), (".parquet", 3), (".shard", 3), (Manifest.FILE, 0)],
)
def test_an_upload_that_fails_leaves_no_dataset_and_the_next_run_makes_what_is_not_whole(
    build: Build, server: S3Server, bucket: str, small_dataset: Run, part: str, times: int
) -> None:
    server.fault = denied(part, times)
    with pytest.raises((DatasetError, OSError), match=f"{bucket}|quota"):
        build(bucket)
    folder = folder_at(bucket) / "3x3"
    assert not (folder / Manifest.FILE).exists()
    finished = {path.name for path in (folder.parent / ".3x3.building").glob("*.shard")}
    server.fault = lambda _method, _path: False
    damaged = {TRAIN.replace(".parquet", ".shard")} if part == Manifest.FILE else set()
    if damaged:
        File(folder / TRAIN).write_bytes((folder / TRAIN).read_bytes()[:-1] + b"?")  # As long.
    server.requests.clear()
    run = build(bucket)
    assert content_of(run.data_dir) == content_of(small_dataset.data_dir)
    uploads = [path.rpartition("/")[2] for method, path in server.requests if method == "PUT"]
    made_again = {path.replace(".parquet", ".shard") for path in uploads if ".parquet" in path}
    assert made_again & finished == damaged
    manifest_at = uploads.index(Manifest.FILE)
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
    assert not (folder_at(memory) / "3x3" / Manifest.FILE).exists()

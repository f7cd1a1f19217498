"""When a shard that is there already is taken as it is."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from labyrinth_core.data.storage import write_bytes
from pipeline.config.run import Run
from pipeline.generation import build as generation
from pipeline.generation import shard as making
from pipeline.generation.shard import ShardJob, finished

Build = Callable[..., Run]


@pytest.fixture
def job(build: Build, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> ShardJob:
    """The job of a shard that a part of a build has made."""
    jobs: list[ShardJob] = []
    make_shard = generation.make_shard
    with monkeypatch.context() as patch:
        patch.setattr(generation, "make_shard", lambda job: jobs.append(job) or make_shard(job))
        build(tmp_path, part="1/1")
    return jobs[0]


OTHERS: dict[str, Callable[[ShardJob], ShardJob]] = {
    "seed": lambda job: replace(job, config=replace(job.config, seed=1)),
    "solutions": lambda job: replace(job, config=replace(job.config, solutions="all")),
    "split": lambda job: replace(job, split="random"),
    "first": lambda job: replace(job, first=1),
    "structures": lambda job: replace(job, structures=job.structures[:-1]),
}


def test_a_shard_is_taken_whatever_else_the_dataset_is_to_hold(job: ShardJob) -> None:
    for more in ({"labyrinths": 99}, {"shifts": ("g",)}):
        taken = finished(replace(job, config=replace(job.config, **more)))
        assert taken is not None
        assert taken.path == job.path.name


@pytest.mark.parametrize("changed", OTHERS)
def test_a_shard_of_another_job_is_not_taken(job: ShardJob, changed: str) -> None:
    assert finished(OTHERS[changed](job)) is None
    assert finished(job) is not None


def test_a_shard_of_other_versions_or_bytes_is_not_taken(
    job: ShardJob, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as patch:
        patch.setattr(making, "build_versions", lambda: {"png": "another"})
        assert finished(job) is None
    for path in (job.path, job.sidecar):
        whole = path.read_bytes()
        write_bytes(path, whole[:-1] + bytes([whole[-1] ^ 1]))
        assert finished(job) is None
        write_bytes(path, whole)
        assert finished(job) is not None

"""When a shard that is there already is taken as it is, and what its fingerprint tells."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.making import Run

from labyrinth_core.data import COLUMNS, Manifest
from labyrinth_core.storage import File
from pipeline.generation import build as generation
from pipeline.generation.shard import Fingerprint, Row, ShardJob, finished

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
        patch.setattr(Manifest, "current_versions", lambda: {"png": "another"})
        assert finished(job) is None
    for path in (job.path, job.sidecar):
        whole = path.read_bytes()
        File(path).write_bytes(whole[:-1] + bytes([whole[-1] ^ 1]))
        assert finished(job) is None
        File(path).write_bytes(whole)
        assert finished(job) is not None


# The fingerprint.


VALUES_OF_KIND = {
    "i": st.integers(-1, 3),
    "f": st.floats(width=32, allow_nan=False),
    "b": st.booleans(),
}


def another(number: float) -> float:
    """Return another value of the same column."""
    if isinstance(number, bool):
        return not number
    return number + 1 if abs(number) < 1e6 else type(number)(0.5)


rows = st.builds(
    Row,
    obs=st.just(b""),
    obs_path=st.just(""),
    numbers=st.tuples(*(VALUES_OF_KIND[column.dtype.kind] for column in COLUMNS.numbers)),
    info=st.text(max_size=9),
    picture_digest=st.binary(min_size=16, max_size=16),
)


def fingerprint(some_rows: list[Row]) -> str:
    fingerprint = Fingerprint()
    fingerprint.update(some_rows)
    return fingerprint.hexdigest()


@pytest.mark.slow
@given(st.lists(rows, min_size=1, max_size=4), st.data())
def test_any_change_of_a_row_changes_the_fingerprint(some: list[Row], data: st.DataObject) -> None:
    place = data.draw(st.integers(0, len(some) - 1))
    row = some[place]
    change = data.draw(
        st.sampled_from(
            [
                *(
                    {"numbers": (*row.numbers[:at], another(number), *row.numbers[at + 1 :])}
                    for at, number in enumerate(row.numbers)
                ),
                {"info": row.info + " "},
                {"picture_digest": row.picture_digest[:15] + bytes([row.picture_digest[15] ^ 1])},
            ]
        )
    )
    changed = [*some[:place], row._replace(**change), *some[place + 1 :]]
    assert fingerprint(changed) != fingerprint(some)

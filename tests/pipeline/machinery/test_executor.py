"""The ordered map, on every executor: the same bytes, and lost workers made up for."""

from __future__ import annotations

import errno
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from subprocess import PIPE
from typing import Any

import distributed
import pytest
from joblib.externals.loky import get_reusable_executor
from support.making import Run
from support.tampering import content_of

from labyrinth_core.data import Dataset, Shard
from labyrinth_core.errors import DatasetError
from pipeline.config import ConfigError
from pipeline.generation import build as generation
from pipeline.generation.build import make_shard
from pipeline.generation.check import validate
from pipeline.machinery import cluster, executor, ordered_map

pytestmark = pytest.mark.slow

Build = Callable[..., Run]


@pytest.fixture(autouse=True)
def _no_workers_stay() -> Iterator[None]:
    yield
    get_reusable_executor().shutdown(wait=True)


def die_once(marker: Path) -> None:
    """End the process that this runs in, the first time."""
    try:
        marker.touch(exist_ok=False)
    except FileExistsError:
        return
    os.kill(os.getpid(), signal.SIGKILL)


def wait_for(marker: Path, item: int) -> int:
    """Return an item when a file is there."""
    while not marker.exists():
        time.sleep(0.01)
    return item


def made_at_last(marker: Path, job: generation.ShardJob) -> Shard:
    """Make a shard, but the worker that has the one of `s0` dies once that of train is made."""
    train = marker.with_name("train-is-made")
    if job.split == "s0":
        wait_for(train, 0)  # On a busy machine the other worker may be late.
        die_once(marker)
    shard = make_shard(job)
    if job.split == "train":
        train.touch()
    return shard


def always_die(_item: int) -> None:
    os.kill(os.getpid(), signal.SIGKILL)


# This machine.


def test_items_are_taken_when_a_worker_is_free(tmp_path: Path) -> None:
    marker = tmp_path / "go"
    taken: list[int] = []
    taken_before: list[int] = []

    def go() -> None:
        taken_before.extend(taken)
        marker.touch()

    def numbers() -> Iterator[int]:
        for number in range(100):
            taken.append(number)
            if number == 2:
                threading.Timer(0.5, go).start()
            yield number

    assert list(ordered_map(partial(wait_for, marker), numbers(), 2)) == list(range(100))
    assert 2 < len(taken_before) < 10


@pytest.mark.parametrize("workers", [1, 2])
def test_an_error_of_the_source_comes_after_the_results_before_it(workers: int) -> None:
    def numbers() -> Iterator[int]:
        yield from range(10)
        raise ConfigError("no more")

    results = []
    with pytest.raises(ConfigError, match="no more"):
        results.extend(ordered_map(abs, numbers(), workers))
    if workers == 1:  # `extend` keeps what came before.
        assert results == list(range(10))


def test_a_lost_worker_is_answered_with_one_line_and_the_next_map_has_others() -> None:
    with pytest.raises(DatasetError, match=r"a worker was lost.*the same command again") as caught:
        list(ordered_map(always_die, range(4), 2))
    assert "\n" not in str(caught.value)
    assert list(ordered_map(abs, range(4), 2)) == [0, 1, 2, 3]


def test_shards_that_were_finished_before_a_worker_was_lost_stay(
    build: Build, tmp_path: Path, small_dataset: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as deadly:
        deadly.setattr(generation, "make_shard", partial(made_at_last, tmp_path / "died"))
        with pytest.raises(DatasetError, match="a worker was lost"):
            build(tmp_path / "data", workers=2)
    kept = list((tmp_path / "data").rglob("train-*.parquet"))
    assert len(kept) == 1
    folder = build(tmp_path / "data", workers=2).folder
    assert content_of(folder) == content_of(small_dataset.folder)


def test_no_more_workers_are_started_than_a_build_has_shards(build: Build, tmp_path: Path) -> None:
    build(tmp_path, workers=60)
    assert get_reusable_executor(reuse=True)._max_workers == 6


def is_empty(group: int) -> bool:
    """Return whether a process group has no processes."""
    try:
        os.killpg(group, 0)
    except ProcessLookupError:
        return True
    return False


@pytest.mark.parametrize("name", ["SIGTERM", "SIGKILL"])
def test_nothing_is_left_of_a_build_whose_first_process_is_ended(name: str, tmp_path: Path) -> None:
    number = getattr(signal, name)  # Windows has one of them.
    options = [f"data_dir={tmp_path}", "size=20", "labyrinths=1000", "stages=[build]"]
    command = [sys.executable, "-m", "pipeline", *options, "workers=2"]
    root = Path(__file__).parents[3]
    with subprocess.Popen(command, cwd=root, start_new_session=True, text=True, stderr=PIPE) as run:
        try:
            for _ in range(6000):
                if len(list(tmp_path.glob(".20x20.building/.*.parquet.*.tmp"))) == 2:
                    break
                time.sleep(0.01)
            os.kill(run.pid, number)
            _, err = run.communicate()
            for _ in range(3000):
                if is_empty(run.pid):
                    break
                time.sleep(0.01)
            assert is_empty(run.pid)
            assert not list(Path("/dev/shm").glob(f"*loky-{run.pid}-*"))
        finally:
            if not is_empty(run.pid):
                os.killpg(run.pid, signal.SIGKILL)
    if number == signal.SIGTERM:
        assert run.returncode == 128 + number
        assert "terminated: run the same command again to resume" in err
        assert list(tmp_path.iterdir()) == []


# Clusters.


def test_a_cluster_is_started_when_there_is_work_with_no_more_processes_than_items(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    local_cluster, started = distributed.LocalCluster, []

    def start(**options: Any) -> distributed.LocalCluster:
        started.append((options["n_workers"], local_cluster(**options)))
        return started[-1][1]

    monkeypatch.setattr(distributed, "LocalCluster", start)
    with cluster("dask", 500):
        for items, processes in ((0, []), (1, [1]), (1, [1]), (2, [1, 2])):
            assert list(ordered_map(abs, [-1] * items, 500)) == [1] * items
            assert [number for number, _ in started] == processes
    assert [each.status.name for _, each in started] == ["closed", "closed"]


def test_a_running_dask_that_loses_a_worker_makes_the_bytes_that_one_process_makes(
    build: Build, tmp_path: Path, small_dataset: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(generation, "make_shard", partial(made_at_last, tmp_path / "died"))
    own = {"n_workers": 2, "threads_per_worker": 1, "dashboard_address": "127.0.0.1:0"}
    with (
        distributed.LocalCluster(**own) as started,
        cluster(started.scheduler_address, 2),
    ):
        folder = build(tmp_path / "data", workers=2).folder
        assert validate(Dataset.at(folder), workers=2) == []
    assert (tmp_path / "died").exists()
    assert content_of(folder) == content_of(small_dataset.folder)


def test_threads_of_one_dask_worker_make_the_bytes_that_one_process_makes(
    build: Build, tmp_path: Path, small_dataset: Run
) -> None:
    own = {"processes": False, "protocol": "tcp", "n_workers": 1, "threads_per_worker": 2}
    with (
        distributed.LocalCluster(**own, dashboard_address="127.0.0.1:0") as started,
        cluster(started.scheduler_address, 2),
    ):
        folder = build(tmp_path).folder
    assert content_of(folder) == content_of(small_dataset.folder)


def a_cluster_without_workers() -> distributed.LocalCluster:
    own = {"processes": False, "protocol": "tcp", "dashboard_address": "127.0.0.1:0"}
    return distributed.LocalCluster(n_workers=0, **own)


def test_workers_that_come_later_are_waited_for_and_the_wait_is_told(
    capsys: pytest.CaptureFixture[str],
) -> None:
    with (
        a_cluster_without_workers() as started,
        cluster(started.scheduler_address, 2),
    ):
        later = threading.Timer(2, lambda: started.scale(1))
        later.start()
        assert list(ordered_map(abs, [-1, -2, -3], 2)) == [1, 2, 3]
        later.join()
    told = f"waiting for a worker of executor={started.scheduler_address}, "
    assert capsys.readouterr().out.replace("\n", " ").startswith(told)


@pytest.mark.parametrize(
    "address",
    ["nonsense", "tcp://127.0.0.1:nonsense", "tcp://127.0.0.1:99999", "tcp://127.0.0.1:9"],
)
def test_a_cluster_that_is_not_there_is_answered_with_one_line_and_not_waited_for(
    address: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    # The client of Dask waits for a minute after it has said that an address is none.
    monkeypatch.setattr(distributed, "Client", pytest.fail)
    with (
        pytest.raises(ConfigError, match=f"executor={address}") as caught,
        cluster(address, 2),
    ):
        pass
    assert "\n" not in str(caught.value)


def test_dask_that_is_not_installed_is_answered_with_one_line(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(ConfigError) as caught, cluster("dask", 2):
        pass
    install = "pip install 'labyrinth-datasets[dask]'"
    assert str(caught.value) == f"executor=dask needs dask: {install}"


def test_processes_that_cannot_be_started_are_answered_with_what_they_need(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def fail() -> None:
        raise OSError(errno.EROFS, "Read-only file system")

    monkeypatch.setattr(executor, "ctrl_c_held_back", fail)
    expected = r"^workers=2: processes cannot be started \(.*Read-only.*/dev/shm"
    with pytest.raises(ConfigError, match=expected):
        list(ordered_map(abs, [1, 2], 2))

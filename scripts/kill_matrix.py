"""Kill builds at random moments, run each again, and compare the results byte for byte.

    python scripts/kill_matrix.py --kills 200 --results local.jsonl
    python scripts/kill_matrix.py --kills 30 --executor dask --workers 2 --results dask.jsonl

A build of 30 shards is forked and gets SIGKILL; then the same build is run to its end in the same
folder. Half of the kills hit the whole process group, as when a machine is switched off, the others
only the first process, whose workers live on for a moment while the build is run again, and then
have to end by themselves. A third of the builds replace another dataset. The moment is between two
events of an undisturbed build: its beginning, each finished shard, its end. A quarter of the kills
is aimed before the first shard and a quarter after the last. A kill after the end is repeated. With
a file for the results, the same command continues where it was stopped.

The exit status is 1 if a dataset differs in anything from that of an undisturbed build, or if a
process or something in shared memory is left.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import shutil
import signal
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from hashlib import sha256
from pathlib import Path
from typing import Any, NamedTuple

import joblib  # noqa: F401  Before builds are forked off, so that each begins at once.
import pyarrow.parquet  # noqa: F401

from pipeline.config.run import Run, RunConfig, resolve
from pipeline.generation import build
from pipeline.machinery.executor import cluster

LABYRINTHS, SHARDS = 40, 5
"""The numbers of labyrinths and of shards of each split."""
ALL_SHARDS = 6 * SHARDS

PHASES = (
    "before the first shard",
    *(f"after {n} to {min(n + 9, ALL_SHARDS - 1)} of {ALL_SHARDS} shards" for n in (1, 11, 21)),
    "after the last shard, before the dataset was in place",
    "with the dataset in place, before all was cleared away",
)
TOO_LATE = "after the end, not counted"

TIME_TO_END = 10.0
"""The seconds in which workers have to end after the first process."""
SHARED = Path("/dev/shm")
LEFT: list[str] = []
"""What builds have left behind."""


class Undisturbed(NamedTuple):
    """The files and the times of a build that is not killed."""

    files: dict[str, str]
    """Path -> SHA-256."""
    times: list[float]
    """The seconds until each number of shards, from 0, was finished; then until the end."""


class Result(NamedTuple):
    """The result of a kill."""

    number: int
    workers: int
    came_to: str
    """One of PHASES, or TOO_LATE."""
    same: bool
    """Whether the dataset is that of an undisturbed build in the end."""

    @property
    def outcome(self) -> str:
        """The result in words."""
        return "the same in the end" if self.same else "DIFFERENT in the end"


@contextmanager
def started(run: Run) -> Iterator[int]:
    """Build in a new process group, yield the id of its first process, and end the group."""
    with warnings.catch_warnings():
        # From Python 3.12 on, about threads of numerical libraries, which are idle.
        warnings.simplefilter("ignore", DeprecationWarning)
        process = os.fork()
    if not process:
        perform(run)
    os.setpgid(process, process)
    try:
        yield process
    finally:
        os.kill(process, signal.SIGKILL)
        os.waitpid(process, 0)  # Not earlier: its id could be reused.
        LEFT.extend(what_is_left(process))


def what_is_left(process: int) -> list[str]:
    """Return what a build leaves whose first process has ended, and remove it."""
    left = []
    waited = 0.0
    with suppress(ProcessLookupError):
        while waited < TIME_TO_END:
            os.killpg(process, 0)
            time.sleep(0.05)
            waited += 0.05
        os.killpg(process, signal.SIGKILL)
        left.append(f"processes of the group {process}")
    return left + clear_memory(process)


def clear_memory(process: int) -> list[str]:
    """Remove what a process has in shared memory, and return the names."""
    found = [*SHARED.glob(f"sem.loky-{process}-*"), *SHARED.glob(f"joblib_*_{process}_*")]
    for path in found:
        shutil.rmtree(path) if path.is_dir() else path.unlink()
    return [path.name for path in found]


def perform(run: Run) -> None:
    """Build in a forked process, and end the process."""
    status = 1
    try:
        os.setpgid(0, 0)
        # joblib's processes print messages when they are killed; an error of the build comes last.
        log = os.open(log_of(run), os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        os.dup2(log, 1)
        os.dup2(log, 2)
        cells = LABYRINTHS // SHARDS * run.dataset.height * run.dataset.width
        with cluster(run.options.executor, run.options.workers):
            build.run(run, cells_per_shard=cells)
        status = 0
    except BaseException:
        traceback.print_exc()
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(status)


def log_of(run: Run) -> Path:
    """Return the file for the output of a build."""
    return Path(f"{run.data_dir}.log")


def finish(run: Run) -> None:
    """Build to the end."""
    with started(run) as process:
        ended = os.waitid(os.P_PID, process, os.WEXITED | os.WNOWAIT)
    if ended is None or ended.si_status:
        print(log_of(run).read_text())
        raise SystemExit(f"a build in {run.data_dir} failed")


def hashes(folder: Path) -> dict[str, str]:
    """Return the SHA-256 of each file below a folder, in which others may be at work."""
    try:
        files = [path for path in sorted(folder.rglob("*")) if path.is_file()]
        return {str(p.relative_to(folder)): sha256(p.read_bytes()).hexdigest() for p in files}
    except FileNotFoundError:
        return hashes(folder)


def finished_shards(run: Run) -> int:
    """Return how many shards a build has finished, as far as its folder tells."""
    return len(list(run.data_dir.glob(".*.building/*-of-*.json")))


def build_undisturbed(run: Run) -> Undisturbed:
    """Build twice with nobody killed: once to see what is made, once to see when."""
    finish(run)
    files = hashes(run.data_dir)
    shutil.rmtree(run.data_dir)
    began, times = time.monotonic(), [0.0]
    with started(run):
        while len(times) <= ALL_SHARDS:
            in_place = (run.folder / "manifest.json").exists()
            shards = ALL_SHARDS if in_place else finished_shards(run)
            times += [time.monotonic() - began] * (shards + 1 - len(times))
            time.sleep(0.0005)
        while hashes(run.data_dir) != files:
            time.sleep(0.0005)
        return Undisturbed(files, [*times, time.monotonic() - began])


def phase(run: Run, undisturbed: Undisturbed) -> str:
    """Return the phase in which a build was killed."""
    there = hashes(run.data_dir)
    manifest = f"{run.folder.name}/manifest.json"
    if there == undisturbed.files:
        return TOO_LATE
    if there.get(manifest) == undisturbed.files[manifest]:
        return PHASES[-1]
    shards = finished_shards(run)
    if shards == ALL_SHARDS:
        return PHASES[-2]
    return PHASES[(shards + 9) // 10]


def kill(run: Run, process: int, moment: tuple[int, float], whole_group: bool) -> None:
    """Kill a build a delay after it has finished some shards, unless it has ended before."""
    shards, delay = moment
    while finished_shards(run) < shards:
        if os.waitid(os.P_PID, process, os.WEXITED | os.WNOWAIT | os.WNOHANG):
            return
        time.sleep(0.0005)
    time.sleep(delay)
    (os.killpg if whole_group else os.kill)(process, signal.SIGKILL)
    os.waitid(os.P_PID, process, os.WEXITED | os.WNOWAIT)
    if whole_group:  # As if the machine had been switched off: nobody is there to clear it.
        clear_memory(process)


def random_moment(rng: random.Random, times: list[float]) -> tuple[int, float]:
    """Return the number of finished shards at which to kill, and a delay in seconds."""
    at_an_end = ALL_SHARDS / 2
    weights = [at_an_end, *[1.0] * (ALL_SHARDS - 1), at_an_end]
    (shards,) = rng.choices(range(ALL_SHARDS + 1), weights)
    return shards, rng.uniform(0, times[shards + 1] - times[shards])


class Matrix:
    """The builds to be killed, in a folder of their own."""

    def __init__(self, folder: Path, executor: str, workers: Sequence[int]) -> None:
        self.folder, self.executor = folder, executor
        self.other = self.run_in("other", 1, executor="local", labyrinths=2)
        finish(self.other)
        self.undisturbed = {
            n: build_undisturbed(self.run_in(f"undisturbed-{n}", n)) for n in workers
        }

    def run_in(self, name: str, workers: int, **options: Any) -> Run:
        """Return the run of a build."""
        fixed = {"stages": ["build"], "size": "4", "labyrinths": LABYRINTHS, "workers": workers}
        where = {"data_dir": str(self.folder / name), "executor": self.executor}
        return resolve(RunConfig(**fixed | where | options))

    def print_times(self) -> None:
        """Print the times of undisturbed builds."""
        for workers, (_, times) in self.undisturbed.items():
            print(
                f"workers={workers}, undisturbed: the first shard after {times[1]:.2f} s, "
                f"the last after {times[-2]:.2f} s, the end after {times[-1]:.2f} s",
                flush=True,
            )

    def kill_in_time(self, number: int, seed: int) -> Iterator[Result]:
        """Kill builds until a kill comes before the end; yield the results."""
        rng = random.Random(f"{seed} {number}")
        came_to = TOO_LATE
        while came_to == TOO_LATE:
            result = self.kill_once(number, rng)
            came_to = result.came_to
            yield result

    def kill_once(self, number: int, rng: random.Random) -> Result:
        """Kill a build and run it to its end."""
        workers = rng.choice(sorted(self.undisturbed))
        undisturbed = self.undisturbed[workers]
        whole_group, overwrite = rng.random() < 1 / 2, rng.random() < 1 / 3
        run = self.run_in("killed", workers, overwrite=overwrite)
        if overwrite:
            shutil.copytree(self.other.data_dir, run.data_dir)
        with started(run) as process:
            kill(run, process, random_moment(rng, undisturbed.times), whole_group)
            came_to = phase(run, undisturbed)
            finish(run)
        same = hashes(run.data_dir) == undisturbed.files
        shutil.rmtree(run.data_dir)
        return Result(number, workers, came_to, same)


def read_results(path: Path | None) -> list[Result]:
    """Return the results of an earlier run."""
    if path is None or not path.exists():
        return []
    return [Result(*json.loads(line)) for line in path.read_text().splitlines()]


def report(results: list[Result], executor: str) -> None:
    """Print the results."""
    counted = [result for result in results if result.came_to != TOO_LATE]
    workers = sorted({result.workers for result in counted})
    print(
        f"{len(counted)} kills, executor={executor}, "
        + ", ".join(f"{sum(r.workers == n for r in counted)} with workers={n}" for n in workers)
    )
    places = Counter(result.came_to for result in results)
    for place in (*PHASES, TOO_LATE):
        print(f"{places[place]:5} {place}")
    print(f"{sum(not result.same for result in results)} datasets differ from the undisturbed one")
    print(f"{len(LEFT)} processes or names in shared memory were left", *LEFT[:10])


def main() -> None:
    """Parse the options, kill, and report."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--executor", default="local", help="local or dask")
    parser.add_argument("--workers", type=int, nargs="+", default=[1, 2], help="to draw from")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--results", type=Path, help="file of the results, to continue from")
    arguments = parser.parse_args()
    results = read_results(arguments.results)
    done = {result.number for result in results if result.came_to != TOO_LATE}
    with (
        tempfile.TemporaryDirectory(prefix="labyrinth-kills-") as folder,
        suppress(KeyboardInterrupt),
    ):
        matrix = Matrix(Path(folder), arguments.executor, arguments.workers)
        matrix.print_times()
        for number in sorted(set(range(arguments.kills)) - done):
            for result in matrix.kill_in_time(number, arguments.seed):
                results.append(result)
                print(f"kill {result.number}, {result.came_to}: {result.outcome}", flush=True)
                if arguments.results:
                    with arguments.results.open("a") as file:
                        file.write(json.dumps(result) + "\n")
    report(results, arguments.executor)
    sys.exit(bool(LEFT) or any(not result.same for result in results))


if __name__ == "__main__":
    main()

"""Kill builds at random moments, run each again, and compare the results byte for byte.

    python scripts/kill_matrix.py --kills 200
    python scripts/kill_matrix.py --kills 30 --executor dask --workers 2
    python scripts/kill_matrix.py --kills 40 --parts 4
    python scripts/kill_matrix.py --kills 36 --stages evaluate results report minari

A build of 30 shards, with at least five chunks of candidate structures, is forked and gets SIGKILL.
Then the same build runs to its end in the same folder. Half of the kills hit the whole process
group, like a power cut; the others hit only the first process, whose workers are still alive when
the build starts again, and have to end by themselves. A third of the builds replace another
dataset. The moment of a kill lies between two events of an uninterrupted build: its start, each
finished shard, its end. A quarter of the kills come before the first shard, and a quarter after the
last. A kill that comes after the end is repeated.

With --parts N, N processes build one part each at the same time. After a random time, all that are
still running are killed and started again, until all parts are finished; then a run without a part
joins them.

With --stages, these stages are killed instead: `evaluate` with a policy of the user, `results`,
`report`, and an export in the format `minari`, `imitation` or `lerobot`. Each kill comes before a
random change of files, in half of the cases while older files are replaced. Then the same stage
runs again. Every file has to be that of an uninterrupted run, and every SHA256SUMS right.

The exit status is 1 if any dataset or folder differs from that of an uninterrupted run, or if a
process or shared memory is left behind.
"""

from __future__ import annotations

import argparse
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
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field, replace
from hashlib import sha256
from mmap import mmap
from pathlib import Path
from typing import Any, NamedTuple, NoReturn

import joblib  # noqa: F401  Imported before forking, so that each process starts at once.
import PIL.Image  # noqa: F401
import pyarrow.parquet  # noqa: F401

from pipeline.command.composed import ALL, resolve
from pipeline.config import ExportOptions, Job
from pipeline.evaluation import evaluate
from pipeline.evaluation.options import EvaluationOptions
from pipeline.export import stage as export
from pipeline.generation import build
from pipeline.machinery import cluster
from pipeline.report import report
from pipeline.results import results

LABYRINTHS, SHARDS = 40, 5
"""The number of labyrinths and of shards in each split."""
ALL_SHARDS = 6 * SHARDS
CELLS_PER_CHUNK = 16 * 40, 16 * 20
"""The cells of the first and of each later chunk of candidates; about 130 candidates are needed."""

PHASES = (
    "before the first shard",
    *(f"after {n} to {min(n + 9, ALL_SHARDS - 1)} of {ALL_SHARDS} shards" for n in (1, 11, 21)),
    "after the last shard, before the dataset was in place",
    "with the dataset in place, before all was cleared away",
)
IN_PARTS = "while parts were made"
TOO_LATE = "after the end, not counted"

TIME_TO_END = 10.0
"""The seconds within which workers have to end after the first process."""
SHARED = Path("/dev/shm")


class Undisturbed(NamedTuple):
    """The files and the timing of an uninterrupted build."""

    files: dict[str, str]
    """Path -> SHA-256."""
    times: list[float]
    """The seconds until 0, 1, 2, ... shards were finished; then until the end."""


@dataclass
class Found:
    """The outcome of the kills."""

    phases: Counter[str] = field(default_factory=Counter)
    """Phase -> the number of builds that were killed in it."""
    different: int = 0
    """The number of final datasets that differ from that of an uninterrupted build."""
    left: list[str] = field(default_factory=list)
    """The processes and the names in shared memory that builds left behind."""


@contextmanager
def started(run: Job[Any], left: list[str]) -> Iterator[int]:
    """Build in a new process group, yield the id of its first process, and end the group.

    Processes and shared memory that the build leaves behind are added to `left`.
    """
    with warnings.catch_warnings():
        # Python 3.12 and later warn about threads of numerical libraries, which are idle.
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
        left.extend(what_is_left(process))


def perform(run: Job[Any]) -> None:
    """Build in a forked process, and exit."""

    def act() -> None:
        cells = LABYRINTHS // SHARDS * run.dataset.height * run.dataset.width
        with cluster(run.options.executor, run.options.workers):
            build.run(run, cells_per_shard=cells, cells_per_chunk=CELLS_PER_CHUNK)

    os.setpgid(0, 0)
    # joblib's processes print messages when killed; an error of the build comes last in the log.
    exit_after(act, log_of(run))


def exit_after(act: Callable[[], None], log: Path) -> NoReturn:
    """Call a function in a forked process, with its output in a file; exit with 1 if it raises."""
    status = 1
    try:
        output = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        os.dup2(output, 1)
        os.dup2(output, 2)
        act()
        status = 0
    except BaseException:
        traceback.print_exc()
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(status)


def log_of(run: Job[Any]) -> Path:
    """Return the log file of a build."""
    return Path(f"{run.data_dir}{run.options.part.replace('/', '-of-')}.log")


def what_is_left(process: int) -> list[str]:
    """End and remove what a build leaves behind after its first process; return the names."""
    left = []
    until = time.monotonic() + TIME_TO_END
    with suppress(ProcessLookupError):
        while time.monotonic() < until:
            os.killpg(process, 0)
            time.sleep(0.05)
        os.killpg(process, signal.SIGKILL)
        left.append(f"processes of the group {process}")
    return left + clear_memory(process)


def clear_memory(process: int) -> list[str]:
    """Remove the shared memory of a process, and return the names."""
    found = [*SHARED.glob(f"sem.loky-{process}-*"), *SHARED.glob(f"joblib_*_{process}_*")]
    for path in found:
        shutil.rmtree(path) if path.is_dir() else path.unlink()
    return [path.name for path in found]


def finish(run: Job[Any], left: list[str]) -> None:
    """Build to the end."""
    with started(run, left) as process:
        ended = os.waitid(os.P_PID, process, os.WEXITED | os.WNOWAIT)
    if ended is None or ended.si_status:
        print(log_of(run).read_text())
        raise SystemExit(f"a build in {run.data_dir} failed")


def hashes(folder: Path) -> dict[str, str]:
    """Return the SHA-256 of each file below a folder, in which other processes may be writing."""
    try:
        files = [path for path in sorted(folder.rglob("*")) if path.is_file()]
        return {str(p.relative_to(folder)): sha256(p.read_bytes()).hexdigest() for p in files}
    except FileNotFoundError:
        return hashes(folder)


def finished_shards(run: Job[Any]) -> int:
    """Return the number of finished shards in the folder of a build."""
    return len(list(run.data_dir.glob(".*.building/*.shard")))


def build_undisturbed(run: Job[Any], left: list[str]) -> Undisturbed:
    """Build twice without a kill: once for the files, once for the timing."""
    finish(run, left)
    files = hashes(run.data_dir)
    shutil.rmtree(run.data_dir)
    began, times = time.monotonic(), [0.0]
    with started(run, left):
        while len(times) <= ALL_SHARDS:
            in_place = (run.folder / "manifest.json").exists()
            shards = ALL_SHARDS if in_place else finished_shards(run)
            times += [time.monotonic() - began] * (shards + 1 - len(times))
            time.sleep(0.0005)
        while hashes(run.data_dir) != files:
            time.sleep(0.0005)
        return Undisturbed(files, [*times, time.monotonic() - began])


def phase(run: Job[Any], undisturbed: Undisturbed) -> str:
    """Return the phase in which a build was killed."""
    there = hashes(run.data_dir)
    manifest = f"{run.folder.name}/manifest.json"
    if there == undisturbed.files:
        return TOO_LATE
    if there.get(manifest) == undisturbed.files[manifest]:
        return PHASES[-1]
    shards = finished_shards(run)
    return PHASES[-2] if shards == ALL_SHARDS else PHASES[(shards + 9) // 10]


def kill(run: Job[Any], process: int, times: list[float], rng: random.Random) -> None:
    """Kill a build at a random moment between two of its events, unless it has ended before."""
    weights = [ALL_SHARDS / 2, *[1.0] * (ALL_SHARDS - 1), ALL_SHARDS / 2]
    (shards,) = rng.choices(range(ALL_SHARDS + 1), weights)
    while finished_shards(run) < shards:
        if os.waitid(os.P_PID, process, os.WEXITED | os.WNOWAIT | os.WNOHANG):
            return
        time.sleep(0.0005)
    time.sleep(rng.uniform(0, times[shards + 1] - times[shards]))
    whole_group = rng.random() < 1 / 2
    (os.killpg if whole_group else os.kill)(process, signal.SIGKILL)
    os.waitid(os.P_PID, process, os.WEXITED | os.WNOWAIT)
    if whole_group:  # Like a power cut, which also clears shared memory.
        clear_memory(process)


def kill_parts(run: Job[Any], parts: int, longest: float, rng: random.Random, found: Found) -> None:
    """Build all parts at the same time, and kill and restart them until all are finished.

    Args:
        run: The build, without a part.
        parts: The number of parts.
        longest: The maximum time between two kills, in seconds.
        rng: The source of the times.
        found: The outcome of the kills, which is updated.
    """
    left = [f"{number + 1}/{parts}" for number in range(parts)]
    while left:
        with ExitStack() as stack:
            for part in tuple(left):
                of_part = replace(run, options=replace(run.options, part=part))
                process = stack.enter_context(started(of_part, found.left))
                stack.callback(count, of_part, process, left, found)
            time.sleep(rng.uniform(0, longest))
    finish(run, found.left)


def count(run: Job[Any], process: int, left: list[str], found: Found) -> None:
    """Remove a part from `left` if its process has ended; else count a kill."""
    ended = os.waitid(os.P_PID, process, os.WEXITED | os.WNOWAIT | os.WNOHANG)
    if ended is None:
        found.phases[IN_PARTS] += 1
        return
    if ended.si_status:
        print(log_of(run).read_text())
        raise SystemExit(f"part={run.options.part} of a build in {run.data_dir} failed")
    left.remove(run.options.part)


def kill_builds(folder: Path, given: argparse.Namespace, found: Found) -> None:
    """Kill builds until the requested number of kills came before the end of a build."""

    def run_in(name: str, workers: int, **options: Any) -> Job[Any]:
        fixed = {"stages": ["build"], "size": "4", "labyrinths": LABYRINTHS, "workers": workers}
        where = {"data_dir": str(folder / name), "executor": given.executor}
        return resolve(ALL(**fixed | where | options))["build"]

    other = run_in("other", 1, executor="local", labyrinths=2)
    finish(other, found.left)
    undisturbed = {
        n: build_undisturbed(run_in(f"undisturbed-{n}", n), found.left) for n in given.workers
    }
    rng = random.Random(given.seed)
    while sum(found.phases.values()) - found.phases[TOO_LATE] < given.kills:
        workers = rng.choice(given.workers)
        run = run_in("killed", workers, overwrite=not given.parts and rng.random() < 1 / 3)
        if given.parts:
            before = found.phases[IN_PARTS]
            kill_parts(run, given.parts, undisturbed[workers].times[-1], rng, found)
            same = hashes(run.data_dir) == undisturbed[workers].files
            shutil.rmtree(run.data_dir)
            found.different += not same
            kills = found.phases[IN_PARTS] - before
            print(f"{kills} kills of parts: {'the same' if same else 'DIFFERENT'} in the end")
            continue
        if run.options.overwrite:
            shutil.copytree(other.data_dir, run.data_dir)
        with started(run, found.left) as process:
            kill(run, process, undisturbed[workers].times, rng)
            came_to = phase(run, undisturbed[workers])
            finish(run, found.left)
        same = hashes(run.data_dir) == undisturbed[workers].files
        shutil.rmtree(run.data_dir)
        found.phases[came_to] += 1
        found.different += not same
        print(f"killed {came_to}: {'the same' if same else 'DIFFERENT'} in the end", flush=True)


# Stages that leave files.

CHANGES = ("open", "os.mkdir", "os.remove", "os.rename", "os.rmdir", "shutil.rmtree")
"""The audit events of Python that may change files."""
POLICY = """
import numpy as np

def act(observations):
    return observations.reshape(len(observations), -1).astype(np.int64).sum(1) % 4
"""


def stage_in(folder: Path, stage: str, *, older: bool = False) -> Callable[[], None]:
    """Return a function that runs a stage on the dataset in a folder.

    Args:
        folder: The folder with the dataset, the policy and all that the stage writes.
        stage: The name of the stage, or the format of an export.
        older: Whether to write other files than those of the stage that is killed.
    """
    places = {f"{name}_dir": str(folder / f"{name}s") for name in ("data", "run")}
    places["results_dir"] = str(folder / "results")
    fixed: dict[str, Any] = {"size": "3", "labyrinths": 4, "random_steps": 5, **places}

    def run(module: Any, **options: Any) -> None:
        module.run(*resolve(ALL(**fixed | options)).values())

    def judge(name: str, seed: int) -> None:
        about = EvaluationOptions(name=name, gifs=1)
        run(evaluate, stages=["evaluate"], policy="killed_policy:act", seed=seed, evaluation=about)

    def act() -> None:
        if stage == "build":
            run(build, stages=["build"])
        elif stage == "evaluate":
            judge("mine", int(older))
        elif stage in ("results", "report"):
            if not older:
                judge("another", 0)
            run({"results": results, "report": report}[stage], stages=[stage])
        else:
            asked = ExportOptions(format=stage, folder=str(folder / "exports"), splits=("test",))
            asked = replace(asked, image_size=16 if older else 32)
            run(export, stages=["export"], export=asked, overwrite=True)

    return act


def ended(act: Callable[[], None], log: Path, before: Callable[[], None] = lambda: None) -> int:
    """Call two functions in a forked process, and return the status that `os.waitpid` gives."""
    process = os.fork()
    if not process:

        def both() -> None:
            before()
            act()

        exit_after(both, log)
    return os.waitpid(process, 0)[1]


def killing(folder: Path, most: int, counter: mmap) -> Callable[[], None]:
    """Return a function that lets its process be killed after `most` changes below a folder.

    Args:
        folder: The folder.
        most: The number of changes that come before the kill.
        counter: Memory that processes share, for the number of changes.
    """
    counter[:] = bytes(len(counter))

    def hook(event: str, arguments: tuple[Any, ...]) -> None:
        if event in CHANGES and str(arguments[0]).startswith(str(folder)):
            is_read = event == "open" and not arguments[2] & (os.O_WRONLY | os.O_RDWR)
            done = int.from_bytes(counter[:]) + (not is_read)
            if done > most:
                os.kill(os.getpid(), signal.SIGKILL)
            counter[:] = done.to_bytes(len(counter))

    return lambda: sys.addaudithook(hook)


def wrong_lists(folder: Path) -> list[str]:
    """Return each name that a SHA256SUMS below a folder lists twice or with another hash."""
    wrong = []
    for path in folder.rglob("SHA256SUMS"):
        lines = [line.split("  ", 1) for line in path.read_text().splitlines() if line[0] != "#"]
        for digest, name in lines:
            file = path.parent / name
            if not file.is_file() or sha256(file.read_bytes()).hexdigest() != digest:
                wrong.append(str(file.relative_to(folder)))
    return wrong


def kill_stages(folder: Path, given: argparse.Namespace, found: Found) -> None:
    """Kill each stage the requested number of times, and run it again after each kill."""
    rng, log, work = random.Random(given.seed), folder / "log", folder / "work"
    counter = mmap(-1, 8)
    sys.path.insert(0, str(folder))
    (folder / "killed_policy.py").write_text(POLICY)

    def do(act: Callable[[], None]) -> None:
        if ended(act, log):
            print(log.read_text())
            raise SystemExit(f"a stage in {work} failed")

    do(stage_in(work, "build"))
    do(stage_in(work, "evaluate"))
    prepared = work.rename(folder / "prepared")
    for stage in given.stages:
        act, started_again, lists = stage_in(work, stage), 0, 0
        for older in [False, True]:
            begun = folder / f"begun-{stage}-{older}"
            shutil.copytree(prepared, work)
            if older:
                do(stage_in(work, stage, older=True))
            shutil.copytree(work, begun)
            do(act)
            files = hashes(work)
            shutil.rmtree(work)
            shutil.copytree(begun, work)
            ended(act, log, killing(work, 10**6, counter))
            changes = int.from_bytes(counter[:])
            for _ in range(given.kills // 2):
                shutil.rmtree(work)
                shutil.copytree(begun, work)
                if not ended(act, log, killing(work, rng.randrange(changes), counter)):
                    found.phases[TOO_LATE] += 1
                    continue
                found.phases[stage] += 1
                started_again += not ended(act, log)
                found.different += hashes(work) != files
                lists += not wrong_lists(work)
            shutil.rmtree(work)
        print(
            f"{found.phases[stage]} kills of {stage}: the same command goes on after "
            f"{started_again}, every SHA256SUMS is right after {lists}",
            flush=True,
        )
        found.different += found.phases[stage] - min(started_again, lists)


def main() -> None:
    """Parse the options, kill, and report."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--executor", default="local", help="local or dask")
    parser.add_argument("--workers", type=int, nargs="+", default=[1, 2], help="drawn per build")
    parser.add_argument("--parts", type=int, default=0, help="parts of each build; 0 for none")
    parser.add_argument("--stages", nargs="+", default=[], help="stages to kill, not builds")
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    found = Found()
    with (
        tempfile.TemporaryDirectory(prefix="labyrinth-kills-") as folder,
        suppress(KeyboardInterrupt),
    ):
        (kill_stages if given.stages else kill_builds)(Path(folder).resolve(), given, found)
    if given.stages:
        print(f"{found.different} folders differ from those of an uninterrupted run")
        sys.exit(bool(found.different))
    counted = sum(found.phases.values()) - found.phases[TOO_LATE]
    parts = f", parts={given.parts}" if given.parts else ""
    print(f"{counted} kills, executor={given.executor}, workers={given.workers}{parts}")
    for place in (IN_PARTS,) if given.parts else (*PHASES, TOO_LATE):
        print(f"{found.phases[place]:5} {place}")
    print(f"{found.different} datasets differ from the undisturbed one")
    print(f"{len(found.left)} processes or names in shared memory were left", *found.left[:10])
    sys.exit(bool(found.left or found.different))


if __name__ == "__main__":
    main()

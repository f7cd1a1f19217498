"""Kill builds at random moments, run each again, and compare what is finished byte for byte.

    python scripts/kill_matrix.py --kills 200
    python scripts/kill_matrix.py --kills 30 --executor dask

A build of 30 shards is forked off and gets SIGKILL: every second time the whole process group, as
when a machine is switched off, every other time its first process alone, whose workers then live
on for a while. Then the same build is run to its end in the same folder. Ends with status 1 if a
dataset differs from that of an undisturbed build in anything.
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
from collections import Counter
from contextlib import suppress
from hashlib import sha256
from pathlib import Path

from pipeline.config import Run, RunConfig, resolve
from pipeline.executor import cluster
from pipeline.generation import build

LABYRINTHS, SHARDS = 40, 5
"""Of each split."""


def start(run: Run) -> int:
    """Build in a process group of its own; return the id of its first process."""
    process = os.fork()
    if process:
        return process
    status = 1
    try:
        os.setsid()
        # joblib's processes complain when they are killed; an error is the last thing said.
        log = os.open(f"{run.data_dir}.log", os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        os.dup2(log, 1)
        os.dup2(log, 2)
        build.CELLS_PER_SHARD = LABYRINTHS // SHARDS * run.dataset.height * run.dataset.width
        with cluster(run.executor, run.workers):
            build.run(run)
        status = 0
    except BaseException:
        traceback.print_exc()
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(status)


def finish(run: Run) -> None:
    """Build to the end."""
    _, status = os.waitpid(start(run), 0)
    if status:
        print(Path(f"{run.data_dir}.log").read_text())
        raise SystemExit(f"a build in {run.data_dir} failed")


def hashes(folder: Path) -> dict[str, str]:
    """Return the SHA-256 of each file below a folder."""
    files = [path for path in sorted(folder.rglob("*")) if path.is_file()]
    return {str(p.relative_to(folder)): sha256(p.read_bytes()).hexdigest() for p in files}


def finished_shards(run: Run) -> int:
    """Return how many shards a build has finished, as far as its folder tells."""
    return len(list(run.data_dir.glob(".*.building/*-of-*.json")))


def progress(run: Run) -> str:
    """Return how far a build had come."""
    if (run.folder / "manifest.json").exists():
        return "the end, with the dataset in place"
    first = finished_shards(run) // 10 * 10
    return f"{first:2} to {min(first + 9, 6 * SHARDS)} of {6 * SHARDS} shards"


def kill_and_finish(run: Run, shards: int, delay: float, *, whole_group: bool) -> str:
    """Begin a build, kill it after some shards and a delay, build to the end.

    Returns:
        How far it had come.
    """
    process, ended = start(run), 0
    while not ended and finished_shards(run) < shards:
        time.sleep(0.001)
        ended, _ = os.waitpid(process, os.WNOHANG)
    time.sleep(delay)
    if not ended:
        (os.killpg if whole_group else os.kill)(process, signal.SIGKILL)
        os.waitpid(process, 0)
    came_to = progress(run)
    finish(run)
    with suppress(ProcessLookupError):  # Workers that live on would wait for minutes.
        os.killpg(process, signal.SIGKILL)
    return came_to


def main() -> None:
    """Parse the options, kill, and report."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--executor", default="local", help="local or dask")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    rng = random.Random(arguments.seed)
    places: Counter[str] = Counter()
    differing = 0
    began = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="labyrinth-kills-") as temporary:

        def run_in(name: str) -> Run:
            options = {"stages": ["build"], "size": "4", "labyrinths": LABYRINTHS}
            where = {"data_dir": f"{temporary}/{name}", "executor": arguments.executor}
            return resolve(RunConfig(**options, **where, workers=arguments.workers))

        undisturbed = run_in("undisturbed")
        finish(undisturbed)
        seconds = time.monotonic() - began
        expected = hashes(undisturbed.data_dir)
        try:
            for number in range(arguments.kills):
                run = run_in(str(number))
                shards, delay = rng.randint(0, 6 * SHARDS), rng.expovariate(100 / seconds)
                places[kill_and_finish(run, shards, delay, whole_group=number % 2 == 0)] += 1
                if hashes(run.data_dir) != expected:
                    differing += 1
                    print(
                        f"kill {number}: the dataset differs from the undisturbed one", flush=True
                    )
                shutil.rmtree(run.data_dir)
        except KeyboardInterrupt:
            print("stopped early")
    print(
        f"{places.total()} kills, executor={arguments.executor} workers={arguments.workers}, "
        f"in {time.monotonic() - began:.0f} s; an undisturbed build took {seconds:.1f} s"
    )
    for place, count in sorted(places.items()):
        print(f"{count:5} killed at {place}")
    print(f"{differing} datasets differ from the undisturbed one")
    sys.exit(differing > 0)


if __name__ == "__main__":
    main()

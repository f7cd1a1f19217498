"""Build a million labyrinths at 5x5, measure time and memory, and certify the splits.

    python scripts/benchmark_million.py --data-dir million --workers 2
    python scripts/benchmark_million.py --data-dir small --labyrinths 30000

A third of the labyrinths is in each of train, validation and test; random, s0 and s0_and_g are made
from those of train as always. After an interruption, run the script again: finished shards are
kept, and the rates are those of the shards that are still made. With --workers 1 the CPU time of a
row is printed, too, which other jobs on the machine hardly affect. Memory is the resident set of
this process and of its descendants, from /proc, so that the script needs Linux.
"""

from __future__ import annotations

import argparse
import os
import platform
import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from unittest.mock import patch

from labyrinth_core.data.manifest import Manifest, Shard
from pipeline.config.run import RunConfig, resolve
from pipeline.generation import build
from pipeline.inspection.statistics import count_dataset

SHARDS_FOR_A_RATE = 12


def processes(first: int) -> Iterator[int]:
    """Yield the ids of a process and of its descendants."""
    yield first
    try:
        children = Path(f"/proc/{first}/task/{first}/children").read_text().split()
    except FileNotFoundError:
        return
    for child in children:
        yield from processes(int(child))


def memory() -> list[int]:
    """Return the resident sets of this process and of its descendants, in MiB."""
    sizes = []
    for process in processes(os.getpid()):
        try:
            pages = int(Path(f"/proc/{process}/statm").read_text().split()[1])
        except FileNotFoundError:
            continue
        sizes.append(pages * os.sysconf("SC_PAGE_SIZE") >> 20)
    return sizes


@dataclass
class Watch:
    """Measures time and memory while shards are made."""

    finished: int
    """The number of shards of an earlier run, which are only read."""
    every: int
    """The number of shards after which a line is printed."""
    began: float = field(default_factory=time.monotonic)
    made: list[tuple[float, int]] = field(default_factory=list)
    """The time at which each shard was finished, and its number of rows."""
    cpu: list[float] = field(default_factory=list)
    """The CPU seconds of this process at these times."""
    peak: int = 0
    """The peak memory of this process, in MiB."""
    peak_of_all: int = 0
    """The peak memory of this process and its descendants together, in MiB."""

    def __call__(
        self, items: Iterable[tuple[int, Shard]], description: str, total: int
    ) -> Iterator[Shard]:
        """Stand in for `terminal.tracked`."""
        labyrinths = 0
        for count, (amount, shard) in enumerate(items, start=1):
            labyrinths += amount
            if count > self.finished:
                self.made.append((time.monotonic() - self.began, shard.rows))
                self.cpu.append(time.process_time())
            else:
                self.began = time.monotonic()
            self.look()
            if count % self.every == 0 or labyrinths == total:
                self.report(f"{description} {count:5} shards {labyrinths:9,} labyrinths")
            yield shard

    def look(self) -> list[int]:
        """Measure the memory that is in use."""
        sizes = memory()
        self.peak = max(self.peak, sizes[0])
        self.peak_of_all = max(self.peak_of_all, sum(sizes))
        return sizes

    def report(self, where: str) -> None:
        """Print the progress."""
        rows = sum(rows for _, rows in self.made)
        seconds = time.monotonic() - self.began
        own, *others = self.look()
        print(
            f"{where} {rows:11,} rows {seconds:7.0f} s {rows / max(seconds, 1e-9):7,.0f} rows/s "
            f"{own:5} MiB here, {' + '.join(map(str, others)) or 0} MiB in workers",
            flush=True,
        )


def rate(made: list[tuple[float, int]]) -> float:
    """Return the rows per second from the first to the last of some shards."""
    return sum(rows for _, rows in made[1:]) / (made[-1][0] - made[0][0])


def main() -> None:
    """Parse the options, build, certify and print."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--data-dir", required=True)
    parser.add_argument("--labyrinths", type=int, default=1_000_000)
    parser.add_argument("--size", default="5")
    parser.add_argument("--random-steps", type=int, default=100, help="see the option")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--every", type=int, default=6, help="shards per line")
    arguments = parser.parse_args()
    run = resolve(
        RunConfig(
            stages=["build"],
            size=arguments.size,
            labyrinths=-(-arguments.labyrinths // 3),
            random_steps=arguments.random_steps,
            data_dir=arguments.data_dir,
            workers=arguments.workers,
        )
    )
    print(
        f"{platform.system()} {platform.machine()}, {os.cpu_count()} cores, "
        f"Python {platform.python_version()}; {run.dataset.labyrinths:,} labyrinths "
        f"in each of train, validation and test, {run.options.workers} workers"
    )
    finished = len(list(Path(run.data_dir).glob(f".{run.dataset.name}.building/*-of-*.json")))
    watch = Watch(finished, arguments.every)
    with patch.object(build, "tracked", watch):
        build.run(run)
    seconds = time.monotonic() - watch.began
    manifest = Manifest.read(run.folder)
    if watch.made:
        rows = sum(rows for _, rows in watch.made)
        tenth = len(watch.made) // 10
        # Shards come in order, those of random late, so that a few of them give no reliable rate.
        ends = (
            ""
            if tenth < SHARDS_FOR_A_RATE
            else (
                f"the first tenth of the shards {rate(watch.made[:tenth]):,.0f}, "
                f"the last {rate(watch.made[-tenth:]):,.0f} rows/s; "
            )
        )
        if run.options.workers == 1 and tenth >= SHARDS_FOR_A_RATE:
            count = [rows for _, rows in watch.made]
            first = (watch.cpu[tenth - 1] - watch.cpu[0]) / sum(count[1:tenth])
            last = (watch.cpu[-1] - watch.cpu[-tenth]) / sum(count[-tenth + 1 :])
            ends += f"{first * 1e6:.1f} us of CPU time a row there, {last * 1e6:.1f} here; "
        print(
            f"built: {rows:,} rows in {seconds:,.0f} s, {rows / seconds:,.0f} rows/s; "
            f"{ends}peak memory {watch.peak} MiB here, {watch.peak_of_all} MiB in all"
        )
    rows, size = (sum(getattr(s, name) for s in manifest.shards) for name in ("rows", "bytes"))
    print(f"in the files: {rows:,} rows, {size:,} bytes, {size / rows:.0f} a row")
    watch = Watch(0, arguments.every)
    counts = count_dataset(run.folder, manifest, run.options.workers, lambda _: watch.look())
    problems = "; ".join(counts.certificate.problems())
    for pair in counts.certificate.pairs:
        print(
            f"{pair.first} and {pair.second} share {len(pair.equal)} structures, "
            f"{len(pair.mirrored)} when mirror images count"
        )
    print(
        f"certified in {time.monotonic() - watch.began:,.0f} s, peak memory {watch.peak} MiB here, "
        f"{watch.peak_of_all} MiB in all: {problems or 'no structure is where it may not be'}"
    )
    if problems:
        raise SystemExit(1)


if __name__ == "__main__":
    main()

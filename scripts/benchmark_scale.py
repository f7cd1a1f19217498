"""Measure the driver and the workers of a build separately, and how many workers a driver serves.

    python scripts/benchmark_scale.py
    python scripts/benchmark_scale.py --two 100 --picture docs/pictures/scale.png

A first build, in one process, makes a quarter of a shard of each split; a whole shard is taken to
cost four times as much. A second build, with two workers and many shards, is stopped once its
chunks are drawn. When it starts again, its driver does its usual work: it removes duplicates, hands
out shards, and writes table and manifest. But its workers only copy the shards of the first build,
with new ids, so that the driver does not wait. All times are CPU seconds of `time.process_time` in
each process, on which other programs have little influence. The cap is the number of workers that
one driver keeps busy: the workers' seconds per shard, chunks included, over the driver's.
"""

from __future__ import annotations

import argparse
import heapq
import os
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from measuring import machine

from labyrinth_core.data import Shard
from labyrinth_core.errors import DatasetError
from pipeline.command.composed import ALL, resolve
from pipeline.config import Job
from pipeline.generation import build
from pipeline.generation.shard import ShardJob, Sidecar
from pipeline.release.figures import INK, LINE, MUTED, Sheet

SHARDS = {5: 21, 25: 8, 100: 8}
"""Size -> shards per split in the second build; at 5x5 enough for a million structures."""
QUARTER = 4
"""The first build makes one of this many parts of each shard."""
COLOURS = ((0, 102, 204), (204, 85, 0), (0, 140, 90))
MANY = 6_000
"""Shards of simulated builds, large enough that their number is not the limit."""


class Measured(NamedTuple):
    """The CPU seconds of a build of one size."""

    size: int
    labyrinths: int
    shards: int
    driver: float
    """The driver's seconds for the whole build."""
    chunks: list[float]
    """A worker's seconds for each chunk, the first chunk first."""
    shard: float
    """A worker's seconds for a shard, averaged over the splits."""

    @property
    def of_driver(self) -> float:
        """The driver's seconds per shard."""
        return self.driver / self.shards

    @property
    def of_workers(self) -> float:
        """The workers' seconds per shard, including the chunks that its structures come from."""
        return self.shard + sum(self.chunks) / self.shards


@dataclass(frozen=True)
class Timed:
    """Wraps a function, and appends the CPU seconds of each call to a file."""

    function: Callable[[Any], Any]
    log: Path

    def __call__(self, item: Any) -> Any:
        begun = time.process_time()
        result = self.function(item)
        with self.log.open("a") as file:
            file.write(f"{os.getpid()} {time.process_time() - begun}\n")
        return result

    def seconds(self) -> list[float]:
        """Return the CPU seconds of each call."""
        return [float(line.split()[1]) for line in self.log.read_text().splitlines()]

    def busiest(self) -> float:
        """Return the total CPU seconds of the process that spent the most."""
        of_process: dict[str, float] = defaultdict(float)
        for line in self.log.read_text().splitlines():
            process, seconds = line.split()
            of_process[process] += float(seconds)
        return max(of_process.values())


def stop(_job: ShardJob) -> Shard:
    """Replace `make_shard` to stop a build before its first shard."""
    raise DatasetError("stopped")


@dataclass(frozen=True)
class Copies:
    """Replaces `make_shard`: copies a quarter of a shard under the name of another shard."""

    building: Path
    """The folder of the build that made the quarter shards."""

    def __call__(self, job: ShardJob) -> Shard:
        path = self.building / "shards" / f"{job.split}-00000-of-00001.parquet"
        made = Sidecar.read(replace(job, path=path, building=self.building))
        facts = np.resize(made.facts, QUARTER * len(made.facts))
        shard = replace(made.shard, path=job.path.name, labyrinths=len(facts))
        for ids in ("labyrinth_id", "structure_id"):
            facts[ids] = np.random.default_rng(job.first).integers(2**63, size=len(facts))
        os.link(path, str(job.path))
        Sidecar.of(job, shard, facts).write(job)
        return shard


def measure(size: int, folder: Path) -> Measured:
    """Build a size in a folder, as the module describes, and return the CPU seconds."""
    of_shard = build.CELLS_PER_SHARD // size**2
    make_shard, draw_chunk = build.make_shard, build.draw_chunk

    def run_of(name: str, labyrinths: int, **options: Any) -> Job[Any]:
        where = {"data_dir": str(folder / name), "size": str(size), "labyrinths": labyrinths}
        return resolve(ALL(stages=("build",), random_steps=10, **where | options))["build"]

    # Built as a part, which leaves its shards and their facts in the building folder.
    one = run_of("one", of_shard // QUARTER, part="1/1")
    made = Timed(make_shard, folder / "shards.log")
    build.make_shard = made
    build.run(one)
    drawn = Timed(draw_chunk, folder / "chunks.log")
    build.make_shard, build.draw_chunk = stop, drawn
    many = run_of("many", of_shard * SHARDS[size], workers=2)
    with suppress(DatasetError):
        build.run(many)
    build.make_shard = Copies(one.data_dir / f".{one.folder.name}.building")
    build.draw_chunk = draw_chunk
    begun = time.process_time()
    build.run(many)
    driver = time.process_time() - begun
    build.make_shard = make_shard
    seconds = made.seconds()
    chunks = sorted(drawn.seconds(), reverse=True)
    shards = SHARDS[size] * len(many.dataset.splits)
    shard = QUARTER * sum(seconds) / len(seconds)
    return Measured(size, many.dataset.labyrinths, shards, driver, chunks, shard)


def twice_as_fast(size: int, folder: Path) -> float:
    """Return the speed of two workers relative to one, from CPU seconds that include the driver's.

    Two shards per split are built with one worker and with two. On an idle machine, a build takes
    as long as its driver plus its busiest worker.
    """
    make_shard, draw_chunk, times = build.make_shard, build.draw_chunk, []
    for workers in (1, 2):
        place = folder / f"{workers}-workers"
        place.mkdir()
        log = place / "calls.log"
        build.make_shard, build.draw_chunk = Timed(make_shard, log), Timed(draw_chunk, log)
        begun = time.process_time()
        build.run(
            resolve(
                ALL(
                    stages=("build",),
                    data_dir=str(place / "data"),
                    size=str(size),
                    labyrinths=2 * build.CELLS_PER_SHARD // size**2,
                    workers=workers,
                )
            )["build"]
        )
        times.append(time.process_time() - begun)
        if workers > 1:
            times[-1] += Timed(make_shard, log).busiest()
    build.make_shard, build.draw_chunk = make_shard, draw_chunk
    return times[0] / times[1]


def makespan(tasks: Sequence[float], workers: int, interval: float = 0.0) -> float:
    """Return how long workers take for tasks, one of which is handed out per interval."""
    free = [0.0] * workers
    for number, seconds in enumerate(tasks):
        heapq.heapreplace(free, max(free[0], number * interval) + seconds)
    return max(free)


def simulated(measured: Measured, shards: int, workers: int) -> float:
    """Return the simulated speed of a driver and its workers, relative to one core.

    The chunks are drawn first. Then the driver hands out the shards at an even rate.
    """
    times = shards / measured.shards
    first, *others = measured.chunks
    chunks = [first, *others * round(times)]
    made = makespan([measured.shard] * shards, workers, measured.of_driver)
    alone = sum(chunks) + shards * (measured.shard + measured.of_driver)
    return alone / (makespan(chunks, workers) + made + measured.of_driver)


def draw(results: Sequence[Measured], two: float | None, path: Path) -> None:
    """Draw the simulated speed for 1 to 1,000 workers, and the measured speed for 1 and 2."""
    sheet, (left, top, right, bottom) = Sheet(820), (130, 60, 1040, 700)

    def at(workers: float, times: float) -> tuple[float, float]:
        x, y = (float(np.log10(value)) / 3 for value in (workers, times))
        return left + x * (right - left), bottom - y * (bottom - top)

    for tick in (1, 10, 100, 1000):
        (x, _), (_, y) = at(tick, 1), at(1, tick)
        sheet.box(x, top, x + 2, bottom, LINE)
        sheet.box(left, y, right, y + 2, LINE)
        sheet.text((x, bottom + 45), f"{tick:,}", 31, MUTED, "ms")
        sheet.text((left - 14, y + 10), f"{tick:,}", 31, MUTED, "rs")
    sheet.text((left, top - 20), "times as fast as one core", 31, INK)
    sheet.text((right, bottom + 95), "workers", 31, INK, "rs")
    for place, (measured, colour) in enumerate(zip(results, COLOURS, strict=False)):
        workers = np.unique(np.geomspace(1, 1000, 300).astype(int))
        for shards, width in ((MANY, 5), (measured.shards, 2)):
            if shards != MANY and place:
                continue
            points = np.array([at(n, simulated(measured, shards, n)) for n in workers.tolist()])
            columns = np.arange(left, right)
            for x, y in zip(columns, np.interp(columns, *points.T), strict=True):
                sheet.box(x, y - width // 2, x + width, y + width - width // 2, colour)
        name = f"{measured.size}x{measured.size}, {MANY:,} shards"
        sheet.text((left + 30, top + 60 + 44 * place), name, 31, colour)
    thin = f"thin: {results[0].size}x{results[0].size}, {results[0].shards} shards"
    sheet.text((left + 30, top + 60 + 44 * len(results)), thin, 31, COLOURS[0])
    for number, times in ((1, 1.0), (2, two)):
        if times is not None:
            x, y = at(number, times)
            sheet.box(x - 9, y - 9, x + 9, y + 9, INK)
    path.write_bytes(sheet.png())


def main() -> None:
    """Parse the options, measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--sizes", type=int, nargs="*", choices=SHARDS, default=[*SHARDS])
    parser.add_argument("--two", type=int, metavar="SIZE", help="build it with 1 and 2 workers")
    parser.add_argument("--picture", type=Path, help="file for the simulated speeds")
    given = parser.parse_args()
    print(machine("numpy", "pyarrow", "joblib"), flush=True)
    results: list[Measured] = []
    for size in given.sizes:
        with tempfile.TemporaryDirectory(prefix="labyrinth-scale-") as folder:
            results.append(measure(size, Path(folder)))
    print("| size | labyrinths a split | shards | driver, ms a shard | workers, ms a shard | cap |")
    print("|---|--:|--:|--:|--:|--:|")
    for each in results:
        print(
            f"| {each.size} | {each.labyrinths:,} | {each.shards} | {each.of_driver * 1e3:.1f} | "
            f"{each.of_workers * 1e3:,.0f} | {each.of_workers / each.of_driver:,.0f} |"
        )
    print("times as fast as one core, simulated:")
    for each in results:
        for shards in (each.shards, MANY):
            speeds = [f"{simulated(each, shards, n):.1f}" for n in (1, 2, 10, 100, 1000)]
            print(f"{each.size}, {shards} shards, 1, 2, 10, 100, 1,000 workers: {speeds}")
    two = None
    if given.two:
        with tempfile.TemporaryDirectory(prefix="labyrinth-scale-") as folder:
            two = twice_as_fast(given.two, Path(folder))
        print(f"two workers at {given.two}x{given.two}: {two:.2f} times as fast as one")
    if given.picture:
        draw(results, two, given.picture)


if __name__ == "__main__":
    main()

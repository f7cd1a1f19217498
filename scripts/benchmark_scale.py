"""Measure the driver of a build and its workers apart, and how many workers one driver serves.

    python scripts/benchmark_scale.py

A first build, in one process, makes a quarter of a shard of each split, of which a shard takes four
times the CPU seconds. A second one, with two workers, is of many shards, and is stopped when its
chunks are drawn. Begun again, its driver does all that it does: it removes repetitions, hands out
shards, writes table and manifest. But its workers copy the shards of the first build, with other
ids, so that the driver does not wait. CPU seconds, which other programs on the machine change
little, are those of `time.process_time` in each process. The cap is the number of workers that one
driver keeps busy: the workers' seconds a shard, with its chunks, over the driver's.
"""

from __future__ import annotations

import argparse
import json
import os
import tempfile
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from measuring import machine

from labyrinth_core.data.errors import DatasetError
from labyrinth_core.data.manifest import Shard
from labyrinth_core.data.storage import write_text
from pipeline.config.run import Run, RunConfig, resolve
from pipeline.generation import build
from pipeline.generation.shards import ShardJob
from pipeline.generation.tabulate import FACTS

SHARDS = {5: 21, 25: 8, 100: 8}
"""Size -> shards a split in the second build; at 5x5 those of a million structures."""
QUARTER = 4
"""The first build makes one such part of each shard."""


class Measured(NamedTuple):
    """CPU seconds of one size."""

    labyrinths: int
    shards: int
    driver: float
    """The driver's seconds a shard."""
    workers: float
    """The workers' seconds a shard, with the chunks that its structures come from."""


@dataclass(frozen=True)
class Timed:
    """A function that adds the CPU seconds of each call to a file."""

    function: Callable[[Any], Any]
    log: Path

    def __call__(self, item: Any) -> Any:
        begun = time.process_time()
        result = self.function(item)
        with self.log.open("a") as file:
            file.write(f"{time.process_time() - begun}\n")
        return result

    def seconds(self) -> list[float]:
        """Return the CPU seconds of each call."""
        return [float(line) for line in self.log.read_text().splitlines()]


def stop(_job: ShardJob) -> Shard:
    """Stand for `make_shard` where no shard is to be made."""
    raise DatasetError("stopped")


@dataclass(frozen=True)
class Copies:
    """Stands for `make_shard`: copies a quarter of a shard under the name of another one."""

    building: Path
    """The folder of the build that it was made in."""

    def __call__(self, job: ShardJob) -> Shard:
        name = f"{job.split}-00000-of-00001"
        made = Shard.from_json(json.loads((self.building / f"{name}.json").read_bytes()))
        facts = np.frombuffer((self.building / f"{name}.facts").read_bytes(), FACTS)
        facts = np.resize(facts, QUARTER * len(facts))
        shard = replace(made, path=job.path.name, labyrinths=len(facts))
        for ids in ("labyrinth_id", "structure_id"):
            facts[ids] = np.random.default_rng(job.first).integers(2**63, size=len(facts))
        os.link(self.building / "shards" / made.path, str(job.path))
        Path(str(job.facts)).write_bytes(facts.tobytes())
        write_text(job.sidecar, json.dumps(asdict(shard)))
        return shard


def measure(size: int, folder: Path) -> Measured:
    """Return the CPU seconds of builds of a size, which are made in a folder."""
    of_shard = build.CELLS_PER_SHARD // size**2
    make_shard, draw_chunk = build.make_shard, build.draw_chunk

    def run_of(name: str, labyrinths: int, **options: Any) -> Run:
        where = {"data_dir": str(folder / name), "size": str(size), "labyrinths": labyrinths}
        return resolve(RunConfig(stages=("build",), random_steps=10, **where | options))

    # As a part, which leaves its shards where they were made, with their facts.
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
    shards = SHARDS[size] * len(many.dataset.splits)
    shard = QUARTER * sum(seconds) / len(seconds)
    workers = shard + sum(drawn.seconds()) / shards
    return Measured(many.dataset.labyrinths, shards, driver / shards, workers)


def main() -> None:
    """Parse the options, measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--sizes", type=int, nargs="*", choices=SHARDS, default=[*SHARDS])
    given = parser.parse_args()
    print(machine("numpy", "pyarrow", "joblib"), flush=True)
    print("| size | labyrinths a split | shards | driver, ms a shard | workers, ms a shard | cap |")
    print("|---|--:|--:|--:|--:|--:|")
    for size in given.sizes:
        with tempfile.TemporaryDirectory(prefix="labyrinth-scale-") as folder:
            found = measure(size, Path(folder))
        print(
            f"| {size} | {found.labyrinths:,} | {found.shards} | {found.driver * 1e3:.1f} | "
            f"{found.workers * 1e3:,.0f} | {found.workers / found.driver:,.0f} |",
            flush=True,
        )


if __name__ == "__main__":
    main()

"""Measure the build, sampling to Parquet, beside the same build with Pillow's PNG encoder.

    python scripts/benchmark_build.py
    python scripts/benchmark_build.py --quick

First on one core with cold caches: train, validation and test, as `python run.py` builds them, once
with start and goal in the corners and once with both anywhere. Our build and Pillow's alternate on
the same labyrinths, so that a busy machine slows both alike; in a round ours has several turns,
because they are short. Times are CPU seconds of the process, over all its threads, divided among
the stages by elapsed time; figures are medians over all turns. The baseline draws the picture as an
array with our renderer and saves it with Pillow, RGB, default level; it computes no fingerprint.

Then whole builds, all six splits, each in a new process, in elapsed time: with one worker, with its
peak memory, and with two workers.
"""

from __future__ import annotations

import argparse
import io
import os
import re
import tempfile
import time
import zlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from itertools import islice
from multiprocessing import get_context
from pathlib import Path
from statistics import median
from typing import NamedTuple, TypeVar
from unittest.mock import patch

from joblib.externals.loky import get_reusable_executor
from measuring import machine
from PIL import Image

from labyrinth_core.data import fingerprint
from labyrinth_core.data.columns import Row
from labyrinth_core.data.dataset_config import DatasetConfig
from labyrinth_core.data.manifest import Manifest
from labyrinth_core.data.splits import SAMPLED_SPLITS
from labyrinth_core.language import text as language
from labyrinth_core.pictures import png, renderer
from labyrinth_core.pictures.renderer import Painter
from labyrinth_core.world.dynamics import State, initial
from labyrinth_core.world.labyrinth import Labyrinth, Structure
from labyrinth_core.world.tasks import change_start_and_goal
from pipeline.config.run import RunConfig, resolve
from pipeline.generation import build
from pipeline.generation.identity import item_rng
from pipeline.generation.render import Picture, Pictures, render
from pipeline.generation.sample import sample
from pipeline.generation.solve import solve
from pipeline.generation.variants import labyrinth_of
from pipeline.generation.write import write

STAGES = {
    "sample": "structures, start and goal",
    "solve": "shortest routes",
    "render": "drawing, encoding, digest",
    "write": "Parquet and hashes",
}
"""Stage -> what it consists of."""


class Scale(NamedTuple):
    """The number of labyrinths of a size."""

    labyrinths: int
    """In each of the three splits, in the comparison with Pillow."""
    quick: int
    whole: int
    """In a whole build, with two or four shards in each split."""


SCALES = {
    "5": Scale(1_000, 10, 32_000),
    "10": Scale(100, 5, 8_000),
    "25": Scale(20, 1, 1_280),
    "100": Scale(2, 1, 160),
}
"""Size -> how many labyrinths."""
PLACES = ("corners", "anywhere")
"""The places of start and goal."""

Item = TypeVar("Item")


class PillowPictures(dict[State, Picture]):
    """A substitute for `render.Pictures` that encodes all pixels with Pillow, default level."""

    def __init__(self, labyrinth: Labyrinth) -> None:
        super().__init__()
        self._painter = Painter(labyrinth)

    def __missing__(self, state: State) -> Picture:
        file = io.BytesIO()
        Image.fromarray(self._painter.array(state)).save(file, "PNG")
        return Picture(file.getvalue(), bytes(16))

    def draw(self, states: Sequence[State]) -> tuple[Sequence[bytes], Sequence[bytes]]:
        """Return files and digests."""
        pngs, digests = zip(*[self[state] for state in states], strict=True)
        return pngs, digests


Way = Callable[[Labyrinth], dict[State, Picture]]
WAYS: dict[str, Way] = {"ours": Pictures, "Pillow": PillowPictures}
TURNS = {"ours": 5, "Pillow": 1}
"""The number of turns in a round. Ours take a second, in which other jobs come and go."""


@dataclass(frozen=True)
class Turn:
    """The measurements of one build."""

    rows: int
    bytes: int
    """The size of the files."""
    seconds: dict[str, float]
    """The time of each stage."""
    writing: float
    """The seconds that `write(2)` takes for the same bytes."""

    @property
    def rate(self) -> float:
        """The number of rows per second."""
        return self.rows / sum(self.seconds.values())


class Stopwatch:
    """Measures the time of each stage; it always runs for one of them."""

    def __init__(self, stage: str) -> None:
        self.seconds = dict.fromkeys(STAGES, 0.0)
        self._stage, self._since = stage, time.perf_counter()

    def turn_to(self, stage: str) -> str:
        """Run for another stage from now on; return the stage before."""
        now, before = time.perf_counter(), self._stage
        self.seconds[before] += now - self._since
        self._stage, self._since = stage, now
        return before

    def timed(self, items: Iterable[Item], stage: str, count: int = 1) -> Iterator[Item]:
        """Yield the items, made `count` at a time, and charge the time to the stage."""
        iterator = iter(items)
        while True:
            before = self.turn_to(stage)
            batch = list(islice(iterator, count))
            self.turn_to(before)
            if not batch:
                return
            yield from batch


def take_turn(config: DatasetConfig, places: str, way: Way) -> Turn:
    """Build the three splits in a temporary folder, as `pipeline.generation.build` does."""
    forget()
    with (
        patch("pipeline.generation.render.Pictures", way),
        tempfile.TemporaryDirectory() as folder,
    ):
        began, clock = time.process_time(), Stopwatch("sample")
        structures = sample(config)
        clock.turn_to("write")
        files = {split: Path(folder) / f"{split}.parquet" for split in SAMPLED_SPLITS}
        written = [
            write(
                file,
                split,
                make_episodes(config, split, places, structures[split], clock),
            )
            for split, file in files.items()
        ]
        clock.turn_to("write")
        share = (time.process_time() - began) / sum(clock.seconds.values())
        content = b"".join(file.read_bytes() for file in files.values())
        return Turn(
            rows=sum(each.rows for each in written),
            bytes=len(content),
            seconds={stage: share * spent for stage, spent in clock.seconds.items()},
            writing=time_of_writing(content, Path(folder) / "again"),
        )


def forget() -> None:
    """Clear the caches of the modules that draw, encode, hash and write."""
    for module in (png, renderer, fingerprint, language):
        for value in vars(module).values():
            if hasattr(value, "cache_clear"):
                value.cache_clear()


def make_episodes(
    config: DatasetConfig,
    split: str,
    places: str,
    structures: list[Structure],
    clock: Stopwatch,
) -> Iterator[list[Row]]:
    """Yield the rows of each episode as `build.make_shard` does, measuring the time by stage."""

    def place() -> Iterator[Labyrinth]:
        for structure in structures:
            labyrinth = labyrinth_of(config, split, structure)
            if places == "anywhere":
                labyrinth = change_start_and_goal(labyrinth, item_rng(config, split, structure))
            yield labyrinth

    count = max(1, build.CELLS_PER_BATCH // (config.height * config.width))
    labyrinths = clock.timed(place(), "sample", count)
    solutions = clock.timed(solve(config, split, labyrinths), "solve", count)
    for number, solution in enumerate(solutions):
        yield from clock.timed(render(split, number, solution.episodes), "render")


def time_of_writing(content: bytes, path: Path) -> float:
    """Return the CPU seconds of writing bytes in one system call."""
    file = os.open(path, os.O_WRONLY | os.O_CREAT)
    begin = time.process_time()
    os.write(file, content)
    seconds = time.process_time() - begin
    os.close(file)
    return seconds


def time_of_deflating(config: DatasetConfig) -> float:
    """Return the CPU seconds that zlib takes, at its default level, for one tile interior.

    That is the least part of a picture that can be new: the row of cells that contains the agent,
    without the lines above and below it, with a filter byte before each row of pixels.
    """
    structure = next(iter(sample(config)["train"]))
    labyrinth = labyrinth_of(config, "train", structure)
    (strip,) = Painter(labyrinth).changes(initial(labyrinth)).values()
    interior = b"".join((b"\0" + row + (b"\2" + bytes(len(row))) * (n - 1)) for row, n in strip)
    begin = time.process_time()
    repeats = 20
    for _ in range(repeats):
        zlib.compress(interior)
    return (time.process_time() - begin) / repeats


def measure(config: DatasetConfig, places: str, rounds: int) -> dict[str, list[Turn]]:
    """Return the turns of each way of making pictures."""
    turns: dict[str, list[Turn]] = {name: [] for name in WAYS}
    for number in range(rounds):
        for name in sorted(WAYS, reverse=number % 2 == 1):
            turns[name] += [take_turn(config, places, WAYS[name]) for _ in range(TURNS[name])]
    return turns


class Whole(NamedTuple):
    """The measurements of a whole build."""

    rows: int
    bytes: int
    seconds: float
    """The elapsed time."""
    memory: int
    """The peak memory of the process in bytes, without that of its workers."""


def build_whole(size: str, labyrinths: int, workers: int) -> Whole:
    """Build all six splits; must be called in a new process."""
    with tempfile.TemporaryDirectory() as folder:
        options = RunConfig(
            stages=["build"], size=size, labyrinths=labyrinths, data_dir=folder, workers=workers
        )
        run = resolve(options)
        begin = time.perf_counter()
        with Path(os.devnull).open("w") as file, redirect_stdout(file), redirect_stderr(file):
            build.run(run)
        seconds = time.perf_counter() - begin
        get_reusable_executor().shutdown()  # Otherwise this process would wait for idle workers.
        shards = Manifest.read(run.folder).shards
    status = Path("/proc/self/status").read_text()
    memory = re.search(r"VmHWM:\s+(\d+) kB", status)
    return Whole(
        rows=sum(shard.rows for shard in shards),
        bytes=sum(shard.bytes for shard in shards),
        seconds=seconds,
        memory=1024 * int(memory[1]) if memory else 0,
    )


def in_a_new_process(size: str, labyrinths: int, workers: int) -> Whole:
    """Return the result of `build_whole` in a new process."""
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        return pool.submit(build_whole, size, labyrinths, workers).result()


def config_of(size: str, labyrinths: int) -> DatasetConfig:
    """Return the configuration of a build."""
    options = RunConfig(stages=["build"], size=size, labyrinths=labyrinths, data_dir="unused")
    return resolve(options).dataset


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sizes", nargs="+", default=list(SCALES), choices=SCALES, metavar="SIZE")
    parser.add_argument("--places", nargs="+", default=PLACES, choices=PLACES, metavar="PLACE")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--no-whole", action="store_true", help="leave out the whole builds")
    parser.add_argument("--quick", action="store_true", help="few labyrinths, one round")
    arguments = parser.parse_args()
    rounds = 1 if arguments.quick else arguments.rounds
    print(machine("numpy", "pillow", "pyarrow"))
    print(f"One core, cold caches, CPU time, medians of {rounds} rounds")
    print("; ".join(f"{stage}: {content}" for stage, content in STAGES.items()))
    measure(config_of("3", labyrinths=2), "corners", rounds=1)  # So that everything is imported.
    for size in arguments.sizes:
        labyrinths = SCALES[size].quick if arguments.quick else SCALES[size].labyrinths
        config = config_of(size, labyrinths)
        for places in arguments.places:
            report(config, places, measure(config, places, rounds))
    if not (arguments.no_whole or arguments.quick):
        print(f"\nWhole builds, by the clock\n{'size':>4}{'rows':>12}{'one worker':>12}", end="")
        print(f"{'two':>8}{'times':>7}{'peak memory':>13}{'files':>9}")
        for size in arguments.sizes:
            report_whole(size, SCALES[size].whole)


def report(config: DatasetConfig, places: str, turns: dict[str, list[Turn]]) -> None:
    """Print the table of one size."""
    rows = turns["ours"][0].rows
    print(f"\nsize {config.height}, start and goal: {places}; {rows:,} rows")
    stages = "".join(f"{stage:>9}" for stage in STAGES)
    print(f"{'':>8}{'rows/s':>9}{stages}  us a row{'bytes a row':>14}")
    for name, of_way in turns.items():
        parts = "".join(
            f"{1e6 * median(turn.seconds[stage] / rows for turn in of_way):9.1f}"
            for stage in STAGES
        )
        rate = median(turn.rate for turn in of_way)
        print(f"{name:>8}{rate:9,.0f}{parts}{of_way[0].bytes / rows:24,.0f}")
    theirs = median(turn.rate for turn in turns["Pillow"])
    ratios = [turn.rate / theirs for turn in turns["ours"]]
    print(f"ours / Pillow: {median(ratios):.1f} times the rows a second", end="")
    print(f" (single turns of ours: {min(ratios):.1f} - {max(ratios):.1f})")
    writing = 1e6 * median(turn.writing / rows for turn in turns["ours"])
    deflating = 1e6 * time_of_deflating(config)
    a_row = 1e6 * median(1 / turn.rate for turn in turns["ours"])
    print(f"a row of ours: {a_row:.1f} us; write(2) of its bytes: {writing:.2f} us; ", end="")
    print(f"deflate of one tile interior: {deflating:.1f} us")


def report_whole(size: str, labyrinths: int) -> None:
    """Build with one worker and with two, and print the measurements."""
    one, two = (in_a_new_process(size, labyrinths, workers) for workers in (1, 2))
    memory, files = one.memory / 2**20, one.bytes / 2**20
    print(f"{size:>4}{one.rows:12,}{one.seconds:10.1f} s{two.seconds:6.1f} s", end="")
    print(f"{one.seconds / two.seconds:7.2f}{memory:9,.0f} MiB{files:5,.0f} MiB", flush=True)


if __name__ == "__main__":
    main()

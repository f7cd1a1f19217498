"""Measure the build, sampling to Parquet, beside the same build with Pillow's PNG encoder.

    python scripts/benchmark_build.py --sizes 5 10 --labyrinths 100 --rounds 5
    python scripts/benchmark_build.py --quick

One process, one core. What is built are train, validation and test, as `python run.py` builds
them. The two encoders take turns in every round, so that a busy machine slows both alike, and each
turn begins with empty caches. The figures are medians over the rounds.
"""

from __future__ import annotations

import argparse
import io
import os
import platform
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from statistics import median
from typing import TypeVar
from unittest.mock import patch

import numpy as np
from PIL import Image

from labyrinth_core import png, renderer
from labyrinth_core.labyrinth import Labyrinth, Structure
from labyrinth_core.png import Strip
from pipeline import manifest
from pipeline.config import DatasetConfig, RunConfig, resolve
from pipeline.generation.render import render
from pipeline.generation.sample import ACTING, item_rng, labyrinth_of, sample
from pipeline.generation.solve import solve
from pipeline.generation.write import write
from pipeline.schema import SAMPLED_SPLITS, Row

STAGES = {
    "sample": "structures and their labyrinths",
    "solve": "shortest routes",
    "render": "drawing and encoding",
    "write": "Parquet and hashes",
}
"""Stage -> what is in it."""

Encoder = Callable[[Sequence[Strip], int], bytes]
Item = TypeVar("Item")


def encode_with_pillow(strips: Sequence[Strip], width: int) -> bytes:
    """Return what `png.encode` does, made by Pillow from all pixels, at its default level."""
    bands = [band for strip in strips for band in strip]
    rows = np.frombuffer(b"".join([row for row, _ in bands]), np.uint8)
    counts = [count for _, count in bands]
    picture = rows.reshape(len(bands), width, 3).repeat(counts, axis=0)
    file = io.BytesIO()
    Image.fromarray(picture).save(file, "PNG")
    return file.getvalue()


ENCODERS: dict[str, Encoder] = {"ours": png.encode, "Pillow": encode_with_pillow}


@dataclass(frozen=True)
class Turn:
    """One build, measured."""

    rows: int
    bytes: int
    """Of the files."""
    seconds: dict[str, float]
    """By stage."""


def build(config: DatasetConfig, encoder: Encoder) -> Turn:
    """Build the three splits in a temporary folder, as `pipeline.generation.build` does."""
    forget()
    seconds = dict.fromkeys(STAGES, 0.0)
    begin = time.perf_counter()
    rows = size = 0
    with (
        patch("pipeline.generation.render.encode", encoder),
        tempfile.TemporaryDirectory() as folder,
    ):
        structures = sample(config)
        seconds["sample"] = time.perf_counter() - begin
        for split in SAMPLED_SPLITS:
            episodes = make_episodes(config, split, structures[split], seconds)
            written = write(Path(folder) / f"{split}.parquet", episodes)
            rows += written.rows
            size += written.bytes
        # Whatever is not spent in the steps before is spent in the last one.
        seconds["write"] = time.perf_counter() - begin - sum(seconds.values())
    return Turn(rows, size, seconds)


def forget() -> None:
    """Clear what earlier turns left in the caches of the modules that draw, encode and hash."""
    for module in (png, renderer, manifest):
        for value in vars(module).values():
            if hasattr(value, "cache_clear"):
                value.cache_clear()


def make_episodes(
    config: DatasetConfig, split: str, structures: list[Structure], seconds: dict[str, float]
) -> Iterator[list[Row]]:
    """Yield the rows of each episode as `build.make_shard` does, adding up the time by stage."""

    def place() -> Iterator[tuple[Labyrinth, np.random.Generator]]:
        for structure in structures:
            rng = item_rng(config, split, structure, ACTING)
            yield labyrinth_of(config, split, structure), rng

    labyrinths = list(timed(place(), "sample", seconds))
    solutions = timed(solve(config, split, labyrinths), "solve", seconds)
    for number, solution in enumerate(solutions):
        yield from timed(render(split, number, solution.episodes), "render", seconds)


def timed(items: Iterable[Item], stage: str, seconds: dict[str, float]) -> Iterator[Item]:
    """Yield the items, adding the time that each takes to come to the seconds of a stage."""
    iterator = iter(items)
    while True:
        begin = time.perf_counter()
        try:
            item = next(iterator)
        except StopIteration:
            return
        finally:
            seconds[stage] += time.perf_counter() - begin
        yield item


def measure(size: str, labyrinths: int, rounds: int) -> dict[str, list[Turn]]:
    """Return the turns of each encoder."""
    options = RunConfig(stages=["build"], size=size, labyrinths=labyrinths, data_dir="unused")
    config = resolve(options).dataset
    turns: dict[str, list[Turn]] = {name: [] for name in ENCODERS}
    for number in range(rounds):
        # Who goes first changes, too.
        for name in sorted(ENCODERS, reverse=number % 2 == 1):
            turns[name].append(build(config, ENCODERS[name]))
    return turns


def rate(turns: list[Turn]) -> float:
    """Return the median of the rows a second."""
    return median(turn.rows / sum(turn.seconds.values()) for turn in turns)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sizes", nargs="+", default=["5", "10"], metavar="SIZE")
    parser.add_argument("--labyrinths", type=int, default=100, help="in each of the three splits")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--quick", action="store_true", help="10 labyrinths, 2 rounds")
    arguments = parser.parse_args()
    labyrinths, rounds = arguments.labyrinths, arguments.rounds
    if arguments.quick:
        labyrinths, rounds = 10, 2
    libraries = ", ".join(f"{name} {version(name)}" for name in ("numpy", "pillow", "pyarrow"))
    print(f"{os.cpu_count()} cores, Python {platform.python_version()}, {libraries}")
    print(f"3 x {labyrinths} labyrinths, medians of {rounds} rounds; one core, cold caches")
    print("; ".join(f"{stage}: {content}" for stage, content in STAGES.items()))
    measure("3", labyrinths=2, rounds=1)  # Once for what is imported on first use.
    for size in arguments.sizes:
        report(size, measure(size, labyrinths, rounds))


def report(size: str, turns: dict[str, list[Turn]]) -> None:
    """Print the table of one size."""
    print(f"\nsize {size}: {turns['ours'][0].rows:,} rows")
    stages = "".join(f"{stage:>9}" for stage in STAGES)
    print(f"{'encoder':>8}{'rows/s':>9}{stages}  us a row{'bytes a row':>14}")
    for name, of_encoder in turns.items():
        parts = "".join(
            f"{1e6 * median(turn.seconds[stage] / turn.rows for turn in of_encoder):9.1f}"
            for stage in STAGES
        )
        size_of_row = of_encoder[0].bytes / of_encoder[0].rows
        print(f"{name:>8}{rate(of_encoder):9,.0f}{parts}{size_of_row:24,.0f}")
    print(
        f"ours / Pillow: {rate(turns['ours']) / rate(turns['Pillow']):.1f} times the rows a second"
    )


if __name__ == "__main__":
    main()

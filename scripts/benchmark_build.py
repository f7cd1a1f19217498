"""Measure builds, compared with Pillow's PNG encoder and between one and two workers.

    python scripts/benchmark_build.py [--sizes N ...] [--rounds N] [--quick]

The first part measures CPU time on one core with cold caches: six splits, with one step of the
random policy in each labyrinth; once with start and goal in the corners, once with both anywhere
(`goals=varied`). Our build and one with Pillow take turns on the same labyrinths. The build with
Pillow uses our renderer, saves RGB at Pillow's default level, and computes no fingerprint.

The second part measures whole builds in wall-clock time, with one worker and with two.
"""

from __future__ import annotations

import io
import os
import tempfile
from collections.abc import Sequence
from contextlib import redirect_stderr, redirect_stdout
from functools import partial
from pathlib import Path
from statistics import median
from typing import NamedTuple
from unittest.mock import patch

from measuring import cpu_seconds, forget, machine, parser_of, ratio, run_command, take_turns
from PIL import Image

from labyrinth_core.data import Manifest
from labyrinth_core.pictures import Painter, StatePictures
from labyrinth_core.world import Labyrinth, State
from pipeline.command.composed import ALL, resolve
from pipeline.generation import build


class Scale(NamedTuple):
    """The number of labyrinths of a size in each of the three splits."""

    compared: int
    quick: int
    whole: int
    """For a whole build, with two or four shards in each split."""


SCALES = {
    "5": Scale(1_000, 10, 32_000),
    "10": Scale(100, 5, 8_000),
    "25": Scale(20, 1, 1_280),
    "100": Scale(2, 1, 160),
}
"""Size -> the numbers of labyrinths."""


class PillowPictures(dict[State, tuple[bytes, bytes]]):
    """Replaces `StatePictures`: encodes all pixels with Pillow at its default level."""

    def __init__(self, labyrinth: Labyrinth) -> None:
        super().__init__()
        self._painter = Painter(labyrinth)

    def __missing__(self, state: State) -> tuple[bytes, bytes]:
        file = io.BytesIO()
        Image.fromarray(self._painter.array(state)).save(file, "PNG")
        return file.getvalue(), bytes(16)

    def draw(self, states: Sequence[State]) -> tuple[Sequence[bytes], Sequence[bytes]]:
        """Return PNG files and digests."""
        pngs, digests = zip(*[self[state] for state in states], strict=True)
        return pngs, digests


def rate(size: str, labyrinths: int, goals: str, pictures: type) -> float:
    """Build a dataset with cold caches, and return the rows per second of CPU time."""
    forget()
    with (
        patch("pipeline.generation.shard.StatePictures", pictures),
        tempfile.TemporaryDirectory() as folder,
        Path(os.devnull).open("w") as nowhere,
        redirect_stdout(nowhere),
        redirect_stderr(nowhere),
    ):
        options = ALL(
            stages=["build"],
            size=size,
            labyrinths=labyrinths,
            random_steps=1,
            goals=goals,
            data_dir=folder,
        )
        run = resolve(options)["build"]
        seconds = cpu_seconds(lambda: build.run(run))
        return sum(shard.rows for shard in Manifest.read(run.folder).shards) / seconds


def compare(size: str, labyrinths: int, rounds: int) -> None:
    """Print the lines of one size: our rate, Pillow's, and their ratio."""
    for place, goals in (("corners", "fixed"), ("anywhere", "varied")):
        ways = {
            name: partial(rate, size, labyrinths, goals, pictures)
            for name, pictures in (("ours", StatePictures), ("Pillow", PillowPictures))
        }
        rates = take_turns(ways, rounds)
        ours, theirs = (median(of_way) for of_way in rates.values())
        middle, extent = ratio(rates["ours"], rates["Pillow"])
        print(f"{size:>4}{place:>12}{ours:14,.0f}{theirs:12,.0f}{middle:>8}{extent:>18}")


def report_whole(size: str, labyrinths: int) -> None:
    """Build with one worker and with two, and print the measurements."""
    with tempfile.TemporaryDirectory() as name:
        common = ["stages=[build]", f"size={size}", f"labyrinths={labyrinths}"]
        one, two = (
            run_command(*common, f"workers={count}", f"data_dir={name}/{count}") for count in (1, 2)
        )
        shards = Manifest.read(Path(name, "1", f"{size}x{size}")).shards
    rows, files = (sum(getattr(each, what) for each in shards) for what in ("rows", "bytes"))
    print(f"{size:>4}{rows:12,}{one.seconds:10.1f} s{two.seconds:6.1f} s", end="")
    print(f"{one.seconds / two.seconds:7.2f}{one.memory:9,} MiB{files >> 20:5,} MiB", flush=True)


def main() -> None:
    """Measure and print."""
    parser = parser_of(__doc__, rounds=3)
    parser.add_argument("--sizes", nargs="+", default=list(SCALES), choices=SCALES, metavar="N")
    parser.add_argument("--no-whole", action="store_true", help="leave out the whole builds")
    arguments = parser.parse_args()
    rounds = 1 if arguments.quick else arguments.rounds
    print(f"{machine('numpy', 'pillow', 'pyarrow')}; CPU time, medians of {rounds} rounds")
    print(f"{'size':>4}{'ends':>12}{'ours, rows/s':>14}{'Pillow':>12}{'times':>8}{'range':>18}")
    for size in arguments.sizes:
        scale = SCALES[size]
        compare(size, scale.quick if arguments.quick else scale.compared, rounds)
    if not (arguments.no_whole or arguments.quick):
        print(f"\nWhole builds, by the clock\n{'size':>4}{'rows':>12}{'one worker':>12}", end="")
        print(f"{'two':>8}{'times':>7}{'peak memory':>13}{'files':>9}")
        for size in arguments.sizes:
            report_whole(size, SCALES[size].whole)


if __name__ == "__main__":
    main()

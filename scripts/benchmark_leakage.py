"""Measure how the time of the leakage certificate grows with the number of labyrinths, at 5x5.

    python scripts/benchmark_leakage.py [--quick]

For each number of labyrinths per split, in seconds of one core: near twins by look-up, as in
`near_twins.nearest` up to 3 walls; the same by comparing all pairs, extrapolated from a part of
them at 100,000; the whole certificate of two splits, without the nearest twins beyond 3 walls; and
the sampler, without and with `splits.min_walls`.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable
from itertools import islice

os.environ.setdefault("OMP_NUM_THREADS", "1")  # Before numpy.

import numpy as np
from measuring import cpu_seconds, machine

from labyrinth_core.world.labyrinth import Labyrinth
from labyrinth_core.world.sampling import sample_structures
from pipeline.config.dataset import SplitsConfig
from pipeline.config.run import RunConfig, resolve
from pipeline.generation.sample import sample
from pipeline.inspection import near_twins
from pipeline.inspection.leakage import find_leakage

PAIRS_TIMED = 10**9
MIN_WALLS = (1, 2, 4)


def sampled(count: int, min_walls: int) -> Callable[[], object]:
    """Return a function that samples a dataset."""
    config = RunConfig(
        stages=["build"], labyrinths=count, splits=SplitsConfig(min_walls), data_dir="nowhere"
    )
    return lambda: sample(resolve(config).dataset)


def measure(count: int) -> list[float]:
    """Return the columns of one line."""
    drawn = sample_structures(5, 5, np.random.default_rng(0))
    structures = list(dict.fromkeys(islice(drawn, 2 * count + count // 10)))[: 2 * count]
    of, among = (near_twins.passage_table(structures[start::2]) for start in (0, 1))
    some = of[: PAIRS_TIMED // count]
    splits = {
        name: [Labyrinth(structure, 0, 24) for structure in structures[start::2]]
        for name, start in (("train", 0), ("test", 1))
    }
    near_twins.MOST_PAIRS = 10**18
    compared = cpu_seconds(lambda: near_twins.nearest(some, among)) * len(of) / len(some)
    near_twins.MOST_PAIRS = 0  # No pairs are compared in what follows.
    looked_up = cpu_seconds(lambda: near_twins.nearest(of, among))
    whole = cpu_seconds(lambda: find_leakage(splits))
    return [looked_up, compared, whole, *(cpu_seconds(sampled(count, w)) for w in MIN_WALLS)]


def main() -> None:
    """Measure and report."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="leave out 100,000 labyrinths")
    arguments = parser.parse_args()
    print(f"{machine('numpy')}; seconds of one core")
    headings = ["labyrinths", "looked up", "all pairs", "certificate"]
    headings += [f"min_walls={walls}" for walls in MIN_WALLS]
    print("".join(f"{heading:>13}" for heading in headings))
    for count in (1_000, 10_000) if arguments.quick else (1_000, 10_000, 100_000):
        print(f"{count:>13,}" + "".join(f"{value:>13.3f}" for value in measure(count)), flush=True)


if __name__ == "__main__":
    main()

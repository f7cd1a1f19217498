"""Measure how fast labyrinths are sampled and solved, beside maze-dataset in the same run.

    pip install maze-dataset 'muutils<0.9'
    python scripts/benchmark_core.py [--sizes N ...] [--rounds N] [--quick]

maze-dataset brings Jupyter and old pins (its 1.4.2 wants a muutils before 0.9): give it a virtual
environment of its own.

A labyrinth is sampled, then solved from one corner to the opposite one, in one process:
maze-dataset by `LatticeMazeGenerators.gen_wilson` or `gen_dfs`, then `find_shortest_path`; ours by
`sample_structures` with the same algorithm, then `Labyrinth`, which checks that there is a path,
and `shortest_route`. Their mazes are spanning trees. So are ours labelled "tree"; "opened" means
that further walls are opened, as in the datasets, so that there are several shortest routes.
Before the measurement, their solver has to find routes as long as ours in our labyrinths.

In each round everyone is timed once, so that a busy machine slows all of them alike. Figures are
medians over the rounds; a ratio is the median of the rounds' ratios.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from functools import partial
from itertools import islice
from statistics import median
from typing import Any, NamedTuple

import numpy as np
from measuring import machine, ratio, take_turns

from labyrinth_core.world.labyrinth import Labyrinth
from labyrinth_core.world.sampling import sample_structures
from labyrinth_core.world.solver import shortest_route

AIM = 50
"""The target: how many times as fast as maze-dataset."""
THEIR_WORK = 200_000
"""The work of maze-dataset in a round, in cells squared, to which its time is proportional."""
OUR_SHARE = 20
"""The number of our labyrinths for each of theirs, for turns of similar length."""


class Turn(NamedTuple):
    """The time per labyrinth in a round, in seconds."""

    sample: float
    solve: float

    @property
    def both(self) -> float:
        """The time to sample and solve a labyrinth."""
        return self.sample + self.solve


Contestant = Callable[[], Turn]


def ours(size: int, count: int, rng: np.random.Generator, **options: Any) -> Turn:
    """Sample and solve our labyrinths."""
    begin = time.perf_counter()
    structures = list(islice(sample_structures(size, size, rng, **options), count))
    sampled = time.perf_counter()
    for structure in structures:
        shortest_route(Labyrinth(structure, 0, size * size - 1), rng)
    return Turn((sampled - begin) / count, (time.perf_counter() - sampled) / count)


def theirs(size: int, count: int, generate: Callable[[tuple[int, int]], Any]) -> Turn:
    """Sample and solve mazes of maze-dataset."""
    begin = time.perf_counter()
    mazes = [generate((size, size)) for _ in range(count)]
    sampled = time.perf_counter()
    for maze in mazes:
        maze.find_shortest_path((0, 0), (size - 1, size - 1))
    return Turn((sampled - begin) / count, (time.perf_counter() - sampled) / count)


def check_routes(size: int, rng: np.random.Generator) -> None:
    """Exit if maze-dataset finds shorter or longer routes in our labyrinths than we do."""
    from maze_dataset import LatticeMaze

    for structure in islice(sample_structures(size, size, rng), 10):
        passages = np.zeros((2, size, size), np.bool_)
        for cell, beside in structure.passages():
            passages[(int(beside == cell + 1), *divmod(cell, size))] = True
        maze = LatticeMaze(connection_list=passages)
        cells = maze.find_shortest_path((0, 0), (size - 1, size - 1))
        moves = shortest_route(Labyrinth(structure, 0, size * size - 1), rng)
        if len(cells) != len(moves) + 1:
            sys.exit(f"of {len(moves)} and {len(cells) - 1} moves one is no shortest route")


def contestants(size: int) -> dict[tuple[str, str], Contestant]:
    """Return what is measured at a size, by maze-dataset's generator and by name."""
    from maze_dataset.generation import LatticeMazeGenerators

    rng = np.random.default_rng(0)
    check_routes(size, rng)
    count = max(4, THEIR_WORK // size**4)
    run = partial(ours, size, OUR_SHARE * count, rng)
    measured: dict[tuple[str, str], Contestant] = {}
    for rival, algorithm in (("gen_wilson", "wilson"), ("gen_dfs", "depth_first")):
        generate = getattr(LatticeMazeGenerators, rival)
        measured[rival, "maze-dataset"] = partial(theirs, size, count, generate)
        measured[rival, f"{algorithm}, tree"] = partial(run, algorithm=algorithm, open_walls=0)
        measured[rival, f"{algorithm}, opened"] = partial(run, algorithm=algorithm)
    return measured


def measure(size: int, rounds: int) -> None:
    """Time everyone at a size, and print the table."""
    turns = take_turns(contestants(size), rounds)
    print(f"\n{f'size {size}':31}{'us to sample':>14}{'to solve':>10}{'a second':>10}", end="")
    print(f"{'times theirs':>14}{'range':>16}{'to reach':>12}")
    for (rival, name), measured in turns.items():
        report(name, rival, measured, turns[rival, "maze-dataset"])


def report(name: str, rival: str, measured: list[Turn], yardstick: list[Turn]) -> None:
    """Print a line of the table."""
    sample, solve, both = (
        median(getattr(turn, part) for turn in measured) for part in ("sample", "solve", "both")
    )
    is_rival = measured == yardstick
    label = f"maze-dataset, {rival}" if is_rival else f"  {name}"
    line = f"{label:31}{1e6 * sample:14,.1f}{1e6 * solve:10,.1f}{1 / both:10,.0f}"
    if not is_rival:
        seconds = ([turn.both for turn in turns] for turns in (yardstick, measured))
        middle, extent, verdict = ratio(*seconds, AIM)
        line += f"{middle:>14}{extent:>16}{verdict:>12}"
    print(line)


def main() -> None:
    """Measure and report."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sizes", nargs="+", type=int, default=[5, 10, 25], metavar="N")
    parser.add_argument("--rounds", type=int, default=7, help="rounds; each times everyone once")
    parser.add_argument("--quick", action="store_true", help="2 rounds")
    arguments = parser.parse_args()
    rounds = 2 if arguments.quick else arguments.rounds
    if rounds < 1:
        parser.error(f"--rounds {rounds}: give a whole number from 1 on")
    try:
        import maze_dataset  # noqa: F401
    except ImportError as error:
        sys.exit(
            "This benchmark compares with maze-dataset, which cannot be imported "
            f"({error}): pip install maze-dataset 'muutils<0.9'"
        )
    print(f"{machine('numpy', 'maze-dataset')}; {rounds} rounds")
    for size in arguments.sizes:
        measure(size, rounds)


if __name__ == "__main__":
    main()

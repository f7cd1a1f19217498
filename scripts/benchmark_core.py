"""How fast labyrinths are sampled and solved, beside maze-dataset in the same run.

    pip install maze-dataset 'muutils<0.9'
    python scripts/benchmark_core.py [--sizes N ...] [--rounds N] [--quick]

maze-dataset brings Jupyter and old pins (its 1.4.2 wants a muutils before 0.9): give it a virtual
environment of its own.

A labyrinth is sampled, then solved from one corner to the opposite one, in one process on both
sides: maze-dataset's `LatticeMazeGenerators.gen_wilson` or `gen_dfs`, then `find_shortest_path`;
ours `sample_structures` with the same algorithm, then `Labyrinth`, which checks that there is a
way, and `shortest_route`. Theirs are spanning trees. So are ours where it says tree; "opened" has
further walls opened, as in the datasets, which makes several shortest routes to choose among.
Before the clock starts, their solver has to find routes as long as ours in our labyrinths.

Each round times every contestant once, one after the other, so that a busy machine slows all of
them alike; a figure is the median over the rounds, that of the ratios where it is a ratio.
"""

from __future__ import annotations

import argparse
import os
import platform
import sys
import time
from collections.abc import Callable
from functools import partial
from importlib.metadata import version
from itertools import islice
from statistics import median
from typing import Any, NamedTuple

import numpy as np

from labyrinth_core.world.labyrinth import Labyrinth
from labyrinth_core.world.sampling import sample_structures
from labyrinth_core.world.solver import shortest_route

AIM = 50
"""Times maze-dataset that are to be reached."""
THEIR_WORK = 200_000
"""Of maze-dataset's work in a round, in cells squared: what its time grows with."""
OUR_SHARE = 20
"""Labyrinths of ours for each of maze-dataset's, for rounds of similar length."""


class Turn(NamedTuple):
    """A labyrinth's share of a round, in seconds."""

    sample: float
    solve: float

    @property
    def both(self) -> float:
        """The time a labyrinth takes."""
        return self.sample + self.solve


Contestant = Callable[[], Turn]


def ours(size: int, count: int, rng: np.random.Generator, **options: Any) -> Turn:
    """Sample and solve labyrinths of ours."""
    begin = time.perf_counter()
    structures = list(islice(sample_structures(size, size, rng, **options), count))
    sampled = time.perf_counter()
    for structure in structures:
        shortest_route(Labyrinth(structure, 0, size * size - 1), rng)
    return Turn((sampled - begin) / count, (time.perf_counter() - sampled) / count)


def theirs(size: int, count: int, generate: Callable[[tuple[int, int]], Any]) -> Turn:
    """Sample and solve labyrinths of maze-dataset."""
    begin = time.perf_counter()
    mazes = [generate((size, size)) for _ in range(count)]
    sampled = time.perf_counter()
    for maze in mazes:
        maze.find_shortest_path((0, 0), (size - 1, size - 1))
    return Turn((sampled - begin) / count, (time.perf_counter() - sampled) / count)


def check_routes(size: int, rng: np.random.Generator) -> None:
    """Stop if maze-dataset finds shorter or longer routes in our labyrinths than we do."""
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


def contestants(size: int) -> dict[str, dict[str, Contestant]]:
    """Return who is measured at a size, by name: for each of maze-dataset's what it is up to."""
    from maze_dataset.generation import LatticeMazeGenerators

    rng = np.random.default_rng(0)
    check_routes(size, rng)
    count = max(4, THEIR_WORK // size**4)
    run = partial(ours, size, OUR_SHARE * count, rng)
    return {
        "gen_wilson": {
            "maze-dataset": partial(theirs, size, count, LatticeMazeGenerators.gen_wilson),
            "wilson, tree": partial(run, algorithm="wilson", open_walls=0),
            "wilson, opened": partial(run, algorithm="wilson"),
        },
        "gen_dfs": {
            "maze-dataset": partial(theirs, size, count, LatticeMazeGenerators.gen_dfs),
            "depth_first, tree": partial(run, algorithm="depth_first", open_walls=0),
            "depth_first, opened": partial(run, algorithm="depth_first"),
        },
    }


def measure(size: int, rounds: int) -> None:
    """Time everyone at a size, and print the table."""
    groups = contestants(size)
    turns: dict[tuple[str, str], list[Turn]] = {
        (rival, name): [] for rival, group in groups.items() for name in group
    }
    for _ in range(rounds + 1):
        for (rival, name), measured in turns.items():
            measured.append(groups[rival][name]())
    print(f"\n{f'size {size}':24}{'us to sample':>14}{'to solve':>10}{'a second':>10}", end="")
    print(f"{'times theirs':>14}{'range':>16}{'to reach':>12}")
    for (rival, name), measured in turns.items():
        # The first round does not count: in it tables are made.
        report(name, rival, measured[1:], turns[rival, "maze-dataset"][1:])


def report(name: str, rival: str, measured: list[Turn], yardstick: list[Turn]) -> None:
    """Print a line of the table."""
    sample, solve, both = (
        median(getattr(turn, part) for turn in measured) for part in ("sample", "solve", "both")
    )
    is_rival = measured == yardstick
    label = f"maze-dataset, {rival}" if is_rival else f"  {name}"
    line = f"{label:24}{1e6 * sample:14,.1f}{1e6 * solve:10,.1f}{1 / both:10,.0f}"
    if not is_rival:
        ratios = [b.both / a.both for a, b in zip(measured, yardstick, strict=True)]
        verdict = f"{AIM}" + ("" if median(ratios) >= AIM else " MISSED")
        extent = f"{min(ratios):,.1f} - {max(ratios):,.1f}"
        line += f"{median(ratios):14,.1f}{extent:>16}{verdict:>12}"
    print(line)


def main() -> None:
    """Measure and report."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sizes", nargs="+", type=int, default=[5, 10, 25], metavar="N")
    parser.add_argument("--rounds", type=int, default=7, help="rounds, each timing everyone once")
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
    packages = ", ".join(f"{name} {version(name)}" for name in ("numpy", "maze-dataset"))
    print(
        f"{platform.system()} {platform.machine()}, {os.cpu_count()} cores, "
        f"Python {platform.python_version()}, {packages}; {rounds} rounds"
    )
    for size in arguments.sizes:
        measure(size, rounds)


if __name__ == "__main__":
    main()

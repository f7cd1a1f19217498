"""Measure how fast labyrinths are sampled and solved, beside maze-dataset in the same run.

    pip install maze-dataset 'muutils<0.9'
    python scripts/benchmark_core.py [--sizes N ...] [--rounds N] [--quick]

maze-dataset brings Jupyter and old pins: give it a virtual environment of its own.

A labyrinth is sampled, then solved from one corner to the opposite one, in one process:
maze-dataset by `LatticeMazeGenerators.gen_wilson` or `gen_dfs`, then `find_shortest_path`; ours by
`sample_structures` with the same algorithm, then `Labyrinth`, which checks that there is a path,
and `shortest_route`. Their mazes are spanning trees. So are ours labelled "tree"; "opened" means
that further walls are opened, as in the datasets, so that there are several shortest routes.
Before the measurement, their solver has to find routes as long as ours in our labyrinths.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from functools import partial
from itertools import islice
from typing import Any

import numpy as np
from measuring import machine, parser_of, per_second, report, take_turns

from labyrinth_core.world.labyrinth import Labyrinth
from labyrinth_core.world.sampling import sample_structures
from labyrinth_core.world.solver import shortest_route

THEIR_WORK = 200_000
"""The work of maze-dataset in a round, in cells squared, to which its time is proportional."""
OUR_SHARE = 20
"""The number of our labyrinths for each of theirs, for turns of similar length."""


def ours(size: int, count: int, rng: np.random.Generator, **options: Any) -> int:
    """Sample and solve our labyrinths, and return how many."""
    for structure in islice(sample_structures(size, size, rng, **options), count):
        shortest_route(Labyrinth(structure, 0, size * size - 1), rng)
    return count


def theirs(size: int, count: int, generate: Callable[[tuple[int, int]], Any]) -> int:
    """Sample and solve mazes of maze-dataset, and return how many."""
    for _ in range(count):
        generate((size, size)).find_shortest_path((0, 0), (size - 1, size - 1))
    return count


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


def measure(size: int, rounds: int) -> None:
    """Time everyone at a size, and print the table."""
    from maze_dataset.generation import LatticeMazeGenerators

    rng = np.random.default_rng(0)
    check_routes(size, rng)
    count = max(4, THEIR_WORK // size**4)
    run = partial(ours, size, OUR_SHARE * count, rng)
    contestants: dict[str, Callable[[], int]] = {}
    rivals = {}
    for generator, algorithm in (("gen_wilson", "wilson"), ("gen_dfs", "depth_first")):
        rival = f"maze-dataset, {generator}"
        contestants[rival] = partial(theirs, size, count, getattr(LatticeMazeGenerators, generator))
        contestants[f"{algorithm}, tree"] = partial(run, algorithm=algorithm, open_walls=0)
        contestants[f"{algorithm}, opened"] = partial(run, algorithm=algorithm)
        rivals |= dict.fromkeys((f"{algorithm}, tree", f"{algorithm}, opened"), rival)
    print(f"\nsize {size}")
    rates = {name: per_second(each, time.perf_counter) for name, each in contestants.items()}
    report(take_turns(rates, rounds), rivals, "labyrinths a second")


def main() -> None:
    """Measure and report."""
    parser = parser_of(__doc__, rounds=7)
    parser.add_argument("--sizes", nargs="+", type=int, default=[5, 10, 25], metavar="N")
    arguments = parser.parse_args()
    rounds = 2 if arguments.quick else arguments.rounds
    try:
        import maze_dataset  # noqa: F401
    except ImportError as error:
        sys.exit(
            f"maze-dataset cannot be imported ({error}): pip install maze-dataset 'muutils<0.9'"
        )
    print(f"{machine('numpy', 'maze-dataset')}; {rounds} rounds")
    for size in arguments.sizes:
        measure(size, rounds)


if __name__ == "__main__":
    main()

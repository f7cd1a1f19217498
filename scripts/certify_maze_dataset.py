"""Certify splits by seed of maze-dataset's own generator.

    pip install maze-dataset 'muutils<0.9'
    python scripts/certify_maze_dataset.py [--folder FOLDER]

maze-dataset brings Jupyter and old pins: give it a virtual environment of its own.

For each size, `gen_dfs` makes a train split from seed 0 and a test split from seed 1. Each is
exported as an array of wall grids, which `leakage.source` reads, and the labyrinths that are read
must have the passages and the ends of the mazes. Then the certificate is printed: how many mazes
were made, how many different ones ("of") the test split has, and how many of these have a
counterpart in train. With `--folder FOLDER` the files remain, for

    python run.py stages=analyse leakage.source=FOLDER/5x5-1000
"""

from __future__ import annotations

import argparse
import sys
import warnings
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from measuring import machine
from numpy.typing import NDArray

from labyrinth_core.language.collection import read_collection
from labyrinth_core.world.labyrinth import Labyrinth
from pipeline.inspection.elsewhere import read_elsewhere
from pipeline.inspection.leakage import NEAR, find_leakage

CASES = ((3, 1_000, 200), (4, 1_000, 200), (5, 1_000, 200), (5, 10_000, 2_000))
"""Size, and mazes of train and of test."""


def save(path: Path, size: int, count: int, seed: int) -> None:
    """Write mazes of maze-dataset as wall grids, and check that the same mazes are read back."""
    from maze_dataset import MazeDataset, MazeDatasetConfig
    from maze_dataset.generation import LatticeMazeGenerators

    config = MazeDatasetConfig(
        name="split",
        grid_n=size,
        n_mazes=count,
        maze_ctor=LatticeMazeGenerators.gen_dfs,
        seed=seed,
    )
    mazes = list(MazeDataset.generate(config))
    np.save(path, np.stack([wall_grid(maze) for maze in mazes]))
    for entry, maze in zip(read_collection(path), mazes, strict=True):
        if not (isinstance(entry.found, Labyrinth) and same(entry.found, maze)):
            sys.exit(f"{entry.place} is read differently: {entry.problem or entry.found}")


def wall_grid(maze: Any) -> NDArray[np.int64]:
    """Return a maze as an array: walls 1, openings 0, the start 2 and the goal 3."""
    pixels = maze.as_pixels(show_endpoints=False, show_solution=False)
    grid: NDArray[np.int64] = 1 - pixels.any(axis=2)
    for mark, (row, column) in ((2, maze.start_pos), (3, maze.end_pos)):
        grid[2 * row + 1, 2 * column + 1] = mark
    return grid


def same(labyrinth: Labyrinth, maze: Any) -> bool:
    """Return whether a labyrinth has the passages and the ends of a maze."""
    height, width = labyrinth.structure.height, labyrinth.structure.width

    def cell(place: Any) -> int:
        return int((height - 1 - place[0]) * width + place[1])

    passages = {tuple(sorted(map(cell, edge))) for edge in maze.as_adj_list()}
    ends = [cell(maze.start_pos), cell(maze.end_pos)]
    return passages == set(labyrinth.structure.passages()) and ends == [
        labyrinth.start,
        labyrinth.goal,
    ]


def report(folder: Path, size: int) -> None:
    """Print what the certificate finds in a folder."""
    found = read_elsewhere(str(folder), None)
    leakage = find_leakage(found.splits)
    (close,) = leakage.pairs
    different = leakage.certificate.labyrinths["test"]
    counterparts = (close.pair.equal, close.pair.mirrored, close.symmetric)
    counts = [len(found.splits["train"]), len(found.splits["test"]), different]
    counts += [*map(len, counterparts), *(close.within(walls) for walls in NEAR)]
    counts.append(len(close.same_route))
    show([f"{size}x{size}", *(f"{count:,}" for count in counts), close.spread(different)])


def show(columns: list[str]) -> None:
    """Print a line of the table."""
    print("".join(f"{column:>9}" for column in columns), flush=True)


def main() -> None:
    """Make the splits, check them, and print what is found."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--folder", type=Path, help="where to leave the files (default: nowhere)")
    arguments = parser.parse_args()
    try:
        import maze_dataset  # noqa: F401
    except ImportError as error:
        sys.exit(f"This needs maze-dataset ({error}): pip install maze-dataset 'muutils<0.9'")
    warnings.filterwarnings("ignore", message=".*trying to override GLOBAL_SEED.*")
    print(machine("numpy", "maze-dataset"))
    walls = [f"{each} wall{'s' * (each > 1)}" for each in NEAR]
    headings = ["size", "train", "test", "of", "equal", "mirrored", "turned", *walls]
    show([*headings, "route", "nearest"])
    with TemporaryDirectory() as temporary:
        for size, train, test in CASES:
            folder = (arguments.folder or Path(temporary)) / f"{size}x{size}-{train}"
            folder.mkdir(parents=True)
            save(folder / "train.npy", size, train, seed=0)
            save(folder / "test.npy", size, test, seed=1)
            report(folder, size)


if __name__ == "__main__":
    main()

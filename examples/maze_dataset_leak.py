"""Mazes of maze-dataset from two seeds: how many test mazes have the walls of one in train.

Needs, in a clone: pip install . maze-dataset 'muutils<0.9'
"""

from maze_dataset import MazeDataset, MazeDatasetConfig
from maze_dataset.generation import LatticeMazeGenerators

from labyrinth_core.language.wall_grid import from_connections


def split(seed: int, mazes: int, size: int) -> set:
    """Return the different mazes of a split: the walls, the start and the goal of each."""
    walk = LatticeMazeGenerators.gen_dfs
    config = MazeDatasetConfig(name="s", grid_n=size, n_mazes=mazes, maze_ctor=walk, seed=seed)
    made = MazeDataset.generate(config)
    return {(from_connections(m.connection_list), *m.start_pos, *m.end_pos) for m in made}


if __name__ == "__main__":
    for size, train, test in ((3, 1_000, 200), (4, 1_000, 200), (5, 1_000, 200)):
        seen = {walls for walls, *_ in split(0, train, size)}
        shown = [walls for walls, *_ in split(1, test, size)]
        print(f"{size}x{size}: {sum(walls in seen for walls in shown)} of {len(shown)}")

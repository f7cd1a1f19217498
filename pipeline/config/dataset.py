"""What a dataset is: the schema of its options, their checks, and the frozen object of them."""

from __future__ import annotations

from dataclasses import dataclass, field

from labyrinth_core.data.dataset_config import DatasetConfig
from labyrinth_core.world.grid import parse_size
from labyrinth_core.world.labyrinth import Task
from labyrinth_core.world.sampling import ALGORITHMS, default_open_walls
from pipeline.config.errors import ConfigError, check_choice


@dataclass
class TaskConfig:
    """The schema of the group `task`."""

    name: str = "navigation"


@dataclass
class BucketsConfig:
    """Percent of all structures that may be in each split; the same for datasets to compare."""

    train: int = 34
    validation: int = 33
    test: int = 33


@dataclass
class SplitsConfig:
    """How far apart the splits are."""

    min_walls: int = 1


@dataclass
class DatasetSchema:
    """The schema of the options; `DATASET_OPTIONS` explains each field."""

    size: str = "5"
    task: TaskConfig = field(default_factory=TaskConfig)
    labyrinths: int | None = None
    solutions: str = "shortest"
    solutions_limit: int = 1000
    random_steps: int = 100
    sampler: str = "wilson"
    open_walls: float | None = None
    buckets: BucketsConfig = field(default_factory=BucketsConfig)
    splits: SplitsConfig = field(default_factory=SplitsConfig)
    seed: int = 0


DATASET_OPTIONS = {
    "size": "rows and columns: 5, or height x width such as 4x6",
    "task": "navigation, partial_observability, key_and_door or icy_floor",
    "labyrinths": "labyrinths in each of train, validation and test (32 at 3x3, else 100)",
    "solutions": "routes a labyrinth: shortest (one), all_shortest, all (every simple route)",
    "solutions_limit": "most routes a labyrinth, for all_shortest and all",
    "random_steps": "steps of the random policy a labyrinth, in the split random",
    "sampler": "spanning tree a structure starts from: " + ", ".join(ALGORITHMS),
    "open_walls": "probability of opening each wall that the tree leaves",
    "buckets": "percent of all structures that may be in each split (buckets.train=...)",
    "splits.min_walls": "least number of walls between structures of two splits (1: not equal)",
    "seed": "same seed and options, same bytes; in training, same weights",
}
"""What each option means, as `python run.py --help` and the README say it."""


def resolve_dataset(config: DatasetSchema) -> DatasetConfig:
    """Return what determines the rows of the dataset that a configuration asks for.

    Raises:
        ConfigError: A value is impossible.
    """
    check_choice("task", config.task.name, [str(task) for task in Task])
    try:
        height, width = parse_size(config.size)
        labyrinths, open_walls = config.labyrinths, config.open_walls
        if labyrinths is None:
            labyrinths = 32 if (height, width) == (3, 3) else 100
        if open_walls is None:
            open_walls = default_open_walls(height, width)
        return DatasetConfig(
            height=height,
            width=width,
            task=Task(config.task.name),
            labyrinths=labyrinths,
            solutions=config.solutions,
            solutions_limit=config.solutions_limit,
            random_steps=config.random_steps,
            sampler=config.sampler,
            open_walls=float(open_walls),
            buckets=(config.buckets.train, config.buckets.validation, config.buckets.test),
            seed=config.seed,
            min_walls=config.splits.min_walls,
        )
    except ValueError as error:
        raise ConfigError(str(error)) from error

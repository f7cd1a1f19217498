"""What a dataset is: the schema of its options, their checks, and the frozen object of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

from labyrinth_core.grid import parse_size
from labyrinth_core.labyrinth import Task
from labyrinth_core.renderer import MAX_PICTURED_SIDE, PICTURE_SIZE
from labyrinth_core.sampling import ALGORITHMS, default_open_walls
from pipeline.errors import ConfigError, check, check_choice, listed

SOLUTIONS = ("shortest", "all_shortest", "all")


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


@dataclass(frozen=True)
class DatasetConfig:
    """All that determines the rows of a dataset, and nothing else; kept in its manifest."""

    height: int
    width: int
    task: Task
    labyrinths: int
    solutions: str
    solutions_limit: int
    random_steps: int
    sampler: str
    open_walls: float
    buckets: tuple[int, int, int]
    """Percent of all structures that may be in train, validation and test."""
    seed: int
    min_walls: int = 1
    """How many walls structures of two splits are apart, at least."""

    @property
    def name(self) -> str:
        """The name of its config on the Hub and of its folder, such as `5x5-key_and_door`."""
        suffix = "" if self.task is Task.NAVIGATION else f"-{self.task}"
        return f"{self.height}x{self.width}{suffix}"

    def to_json(self) -> dict[str, Any]:
        """Return it in plain types; `from_json` is the inverse.

        Datasets from before there was a `min_walls` have none, and those that do not use it
        neither, so that they are the same.
        """
        plain = asdict(self) | {"task": str(self.task), "buckets": list(self.buckets)}
        return {name: plain[name] for name in plain if (name, plain[name]) != ("min_walls", 1)}

    @classmethod
    def from_json(cls, values: Mapping[str, Any]) -> DatasetConfig:
        """Return the config that `to_json` described.

        Raises:
            ValueError: A field is missing, unknown, of the wrong kind, or impossible.
        """
        plain = {"min_walls": 1} | dict(values)
        like = resolve_dataset(DatasetSchema()).to_json() | {"min_walls": 1}
        if _kinds(plain) != _kinds(like):
            raise ValueError(f"a dataset's config has the fields {like}, not {plain}")
        size = f"{plain.pop('height')}x{plain.pop('width')}"
        buckets = BucketsConfig(*plain.pop("buckets"))
        task = TaskConfig(plain.pop("task"))
        splits = SplitsConfig(plain.pop("min_walls"))
        return resolve_dataset(
            DatasetSchema(size=size, buckets=buckets, task=task, splits=splits, **plain)
        )


def resolve_dataset(config: DatasetSchema) -> DatasetConfig:
    """Return what determines the rows of the dataset that a configuration asks for.

    Raises:
        ConfigError: A value is impossible.
    """
    try:
        height, width = parse_size(config.size)
    except ValueError as error:
        raise ConfigError(str(error)) from error
    check(
        max(height, width) <= MAX_PICTURED_SIDE,
        f"size={config.size}: {MAX_PICTURED_SIDE} rows and columns at most fit the datasets' "
        f"pictures of {PICTURE_SIZE} x {PICTURE_SIZE} pixels",
    )
    labyrinths = config.labyrinths
    if labyrinths is None:
        labyrinths = 32 if (height, width) == (3, 3) else 100
    open_walls = config.open_walls
    if open_walls is None:
        open_walls = default_open_walls(height, width)
    buckets = (config.buckets.train, config.buckets.validation, config.buckets.test)
    check_choice("task", config.task.name, [str(task) for task in Task])
    check(labyrinths >= 1, f"labyrinths={labyrinths}: give 1 or more")
    check_choice("solutions", config.solutions, SOLUTIONS)
    check(config.solutions_limit >= 1, f"solutions_limit={config.solutions_limit}: give 1 or more")
    check(config.random_steps >= 1, f"random_steps={config.random_steps}: give 1 or more")
    check_choice("sampler", config.sampler, ALGORITHMS)
    check(0 <= open_walls <= 1, f"open_walls={open_walls}: give a probability from 0 to 1")
    check(
        min(buckets) >= 1 and sum(buckets) == 100,
        f"buckets={listed(buckets)}: give three percentages of 1 or more that add up to 100",
    )
    check(0 <= config.seed < 2**64, f"seed={config.seed}: give 0 or more, below 2**64")
    passages = 2 * height * width - height - width
    check(
        1 <= config.splits.min_walls <= passages,
        f"splits.min_walls={config.splits.min_walls}: give 1 to {passages}, "
        f"as many as walls there can be at {height}x{width}",
    )
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
        buckets=buckets,
        seed=config.seed,
        min_walls=config.splits.min_walls,
    )


def _kinds(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return the type of each value, of a list those of its items."""
    return {
        name: [type(item) for item in value] if isinstance(value, list) else type(value)
        for name, value in values.items()
    }

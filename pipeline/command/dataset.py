"""The options that determine the content of a dataset."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

from labyrinth_core.data import SPLITS, DatasetConfig
from labyrinth_core.language import parse_size
from labyrinth_core.world import ALGORITHMS, BUCKETS, Task, default_open_walls
from pipeline.config import ConfigError, check_options, option

ALL_SHIFTS = "all"
"""The value of `shifts` that stands for every shift that the other options allow."""


@dataclass(frozen=True)
class SplitsConfig:
    """How far apart the splits are."""

    min_walls: int = option(
        1, "least number of walls in which structures of two splits differ (1: not equal)"
    )


@dataclass(frozen=True)
class DemonstrationsConfig:
    """How well the demonstrator acts."""

    noise: float = option(
        0.0, "probability that the demonstrator acts at random, and goes on from there"
    )


@dataclass(frozen=True)
class DatasetOptions:
    """The content of a dataset; `DatasetConfig` checks the values."""

    size: str = option("5", "rows and columns: 5, or height x width such as 4x6")
    task: str = option(
        "navigation",
        f"{', '.join([*Task][:-1])} or {[*Task][-1]}",
        one_of=map(str, Task),
    )
    labyrinths: int | None = option(
        None, "labyrinths in each of train, validation and test (32 at 3x3, else 100)"
    )
    solutions: str = option(
        "shortest", "routes per labyrinth: shortest (one), all_shortest, all (every simple route)"
    )
    solutions_limit: int = option(1000, "maximum routes per labyrinth, for all_shortest and all")
    random_steps: int = option(100, "random steps per labyrinth, in the split random")
    sampler: str = option(
        "wilson", "algorithm of the spanning tree in each structure: " + ", ".join(ALGORITHMS)
    )
    open_walls: float | None = option(
        None,
        "probability of opening each wall that the spanning tree leaves (0.12 at 3x3, 0.09 at "
        "4x4, else 0.08)",
    )
    buckets: tuple[int, ...] = option(
        BUCKETS,
        "percent of all structures that may be in train, in validation and in test; keep it the "
        "same in datasets to compare",
    )
    splits: SplitsConfig = SplitsConfig()
    shifts: tuple[str, ...] = option(
        (),
        "extra splits, each with one thing shifted: all, or a list of " + ", ".join(SPLITS.shifts),
        one_of=(ALL_SHIFTS, *SPLITS.shifts),
    )
    demonstrations: DemonstrationsConfig = DemonstrationsConfig()
    goals: str = option(
        "fixed",
        "where start and goal of train, validation and test lie: fixed (bottom left and top "
        "right) or varied (drawn for each labyrinth)",
    )
    seed: int = option(0, "random seed; the same options and seed give the same bytes or weights")


def dataset_config(options: DatasetOptions) -> DatasetConfig:
    """Return the configuration that determines the rows of the dataset.

    Each option, also of `splits` and `demonstrations`, becomes the field of the same name; `size`
    becomes `height` and `width`.

    Raises:
        ConfigError: A value is invalid.
    """
    check_options(options, DatasetOptions)
    try:
        values = {each.name: getattr(options, each.name) for each in fields(DatasetOptions)}
        height, width = parse_size(values.pop("size"))
        values |= vars(values.pop("splits")) | vars(values.pop("demonstrations"))
        values["task"] = Task(options.task)
        if options.labyrinths is None:
            values["labyrinths"] = 32 if (height, width) == (3, 3) else 100
        if options.open_walls is None:
            values["open_walls"] = default_open_walls(height, width)
        for name in ("open_walls", "noise"):  # Hydra passes 1 as an int.
            values[name] = float(values[name])
        config = DatasetConfig(height=height, width=width, **values | {"shifts": ()})
        return replace(config, shifts=_shifts(config, options.shifts))
    except ValueError as error:
        raise ConfigError(str(error)) from error


def _shifts(config: DatasetConfig, named: tuple[str, ...]) -> tuple[str, ...]:
    """Return the requested shifts in the order of `SPLITS.shifts`; `all` gives every possible one.

    Raises:
        ValueError: `all` is combined with others.
    """
    if named == (ALL_SHIFTS,):
        return tuple(name for name in SPLITS.shifts if config.why_no(name) is None)
    if ALL_SHIFTS in named:
        raise ValueError(
            f"shifts=[{', '.join(named)}]: give all alone, or some of [{', '.join(SPLITS.shifts)}]"
        )
    return tuple(name for name in SPLITS.shifts if name in named)

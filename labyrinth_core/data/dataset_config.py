"""The options that determine the rows of a dataset, as its manifest keeps them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, get_type_hints

from labyrinth_core.pictures.png import PICTURE_SIZE
from labyrinth_core.pictures.renderer import MAX_PICTURED_SIDE
from labyrinth_core.world.grid import parse_size
from labyrinth_core.world.labyrinth import Task
from labyrinth_core.world.sampling import ALGORITHMS
from labyrinth_core.world.tasks import check_open_walls

SOLUTIONS = ("shortest", "all_shortest", "all")
"""The sets of routes that a dataset may demonstrate in each labyrinth."""


@dataclass(frozen=True)
class DatasetConfig:
    """The options that determine the rows of a dataset, and no others.

    Raises:
        ValueError: A value is impossible; the message names the option, the value and what is
            allowed.
    """

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
    """The percentages of all structures that may be in train, validation and test."""
    seed: int
    min_walls: int = 1
    """The least number of walls in which structures of two splits differ."""

    def __post_init__(self) -> None:
        size = f"{self.height}x{self.width}"
        parse_size(size)
        if max(self.height, self.width) > MAX_PICTURED_SIDE:
            raise ValueError(
                f"size={size}: {MAX_PICTURED_SIDE} rows and columns at most fit the datasets' "
                f"pictures of {PICTURE_SIZE} x {PICTURE_SIZE} pixels"
            )
        for name in ("labyrinths", "solutions_limit", "random_steps"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name}={getattr(self, name)}: give 1 or more")
        for name, allowed in {"solutions": SOLUTIONS, "sampler": tuple(ALGORITHMS)}.items():
            if (given := getattr(self, name)) not in allowed:
                raise ValueError(f"{name}={given}: choose one of [{', '.join(allowed)}]")
        if not 0 <= self.open_walls <= 1:
            raise ValueError(f"open_walls={self.open_walls}: give a probability from 0 to 1")
        check_open_walls(self.task, self.open_walls)
        if min(self.buckets) < 1 or sum(self.buckets) != 100:
            raise ValueError(
                f"buckets={list(self.buckets)}: give three percentages of 1 or more that add up "
                "to 100"
            )
        if not 0 <= self.seed < 2**64:
            raise ValueError(f"seed={self.seed}: give 0 or more, below 2**64")
        passages = 2 * self.height * self.width - self.height - self.width
        if not 1 <= self.min_walls <= passages:
            raise ValueError(
                f"splits.min_walls={self.min_walls}: give 1 to {passages}, as many as walls there "
                f"can be at {size}"
            )

    @property
    def name(self) -> str:
        """The name of the config on the Hub and of the folder, such as `5x5-key_and_door`."""
        suffix = "" if self.task is Task.NAVIGATION else f"-{self.task}"
        return f"{self.height}x{self.width}{suffix}"

    def to_json(self) -> dict[str, Any]:
        """Return the options in plain types; `from_json` is the inverse.

        The default of `min_walls` is left out, as in datasets older than the option.
        """
        plain = asdict(self) | {"task": str(self.task), "buckets": list(self.buckets)}
        return {name: plain[name] for name in plain if (name, plain[name]) != ("min_walls", 1)}

    @classmethod
    def from_json(cls, values: Mapping[str, Any]) -> DatasetConfig:
        """Return the config that `to_json` described.

        Raises:
            ValueError: A field is missing, unknown, of the wrong type, or impossible.
        """
        plain = {"min_walls": 1} | dict(values)
        if _types(plain) != _TYPES:
            raise ValueError(f"a dataset's config has the fields {list(_TYPES)}, not {plain}")
        task, tasks = plain.pop("task"), [str(task) for task in Task]
        if task not in tasks:
            raise ValueError(f"task={task}: choose one of [{', '.join(tasks)}]")
        return cls(task=Task(task), buckets=tuple(plain.pop("buckets")), **plain)


_IN_JSON = {Task: str, tuple[int, int, int]: [int, int, int]}
_TYPES = {name: _IN_JSON.get(kind, kind) for name, kind in get_type_hints(DatasetConfig).items()}
"""Field of the JSON object -> its type, for a list the types of its items."""


def _types(values: Mapping[str, Any]) -> dict[str, Any]:
    return {
        name: [type(item) for item in value] if isinstance(value, list) else type(value)
        for name, value in values.items()
    }

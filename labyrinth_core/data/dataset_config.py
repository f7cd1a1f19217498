"""The options that determine the rows of a dataset, as its manifest keeps them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, get_type_hints

from labyrinth_core.data.splits import BASE_SPLITS, SHIFTS, SPLITS
from labyrinth_core.pictures.png import PICTURE_SIZE
from labyrinth_core.pictures.renderer import MAX_PICTURED_SIDE, usual_wall_pixels
from labyrinth_core.world.grid import parse_size
from labyrinth_core.world.labyrinth import Task
from labyrinth_core.world.sampling import ALGORITHMS
from labyrinth_core.world.tasks import check_open_walls

SOLUTIONS = ("shortest", "all_shortest", "all")
"""The sets of routes that a dataset may demonstrate in each labyrinth."""

GOALS = ("fixed", "varied")
"""Where start and goal of train, validation and test may lie: in the corners, or drawn for each."""


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
    shifts: tuple[str, ...] = ()
    """The splits besides the six that every dataset has, in the order of `SHIFTS`."""
    noise: float = 0.0
    """The probability with which a demonstrator takes a uniformly random action."""
    pieces: int = 0
    """The number of steps of the pieces that routes are handed out in; 0 for whole routes."""
    goals: str = "fixed"
    """Where start and goal of train, validation and test lie, one of `GOALS`."""

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
        choices = {"solutions": SOLUTIONS, "sampler": tuple(ALGORITHMS), "goals": GOALS}
        for name, allowed in choices.items():
            if (given := getattr(self, name)) not in allowed:
                raise ValueError(f"{name}={given}: choose one of [{', '.join(allowed)}]")
        if not 0 <= self.open_walls <= 1:
            raise ValueError(f"open_walls={self.open_walls}: give a probability from 0 to 1")
        if not 0 <= self.noise < 1:
            raise ValueError(
                f"demonstrations.noise={self.noise}: give a probability from 0 to below 1"
            )
        if self.noise and self.solutions != "shortest":
            raise ValueError(
                f"demonstrations.noise={self.noise}: give solutions=shortest, not {self.solutions}"
            )
        if self.pieces < 0:
            raise ValueError(
                f"demonstrations.pieces={self.pieces}: give a number of steps, or 0 for whole "
                "routes"
            )
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
        if self.shifts != tuple(name for name in SHIFTS if name in self.shifts):
            raise ValueError(
                f"shifts=[{', '.join(self.shifts)}]: choose from [{', '.join(SHIFTS)}], each once "
                "and in this order"
            )
        for name in self.shifts:
            if reason := self.why_no(name):
                raise ValueError(f"shifts: there is no {name}: {reason}")

    def why_no(self, shift: str) -> str | None:
        """Return why a shift makes no sense with the other options, None if it does."""
        if shift == self.sampler:
            return f"train is sampled by {shift} already"
        if shift == "trees" and self.task is Task.ICY_FLOOR:
            return "ice only matters where there are loops"
        if shift == "trees" and not self.open_walls:
            return "with open_walls=0 train has no loops already"
        if shift == "open" and self.open_walls == 1:
            return "with open_walls=1 train has all loops already"
        kind = SPLITS[shift]
        if kind.parent == "test" and (kind.new_start or kind.new_goal) and self.goals == "varied":
            return "with goals=varied each labyrinth of test has a start and a goal of its own"
        if shift == "one_wall" and self.min_walls > 1:
            return f"splits.min_walls={self.min_walls} keeps structures farther apart"
        if shift == "one_wall" and self.noise:
            return "with demonstrations.noise the demonstrated route is no shortest one"
        if shift == "thin_walls" and usual_wall_pixels(self.height, self.width) == 1:
            return "walls are one pixel thick already"
        return None

    @property
    def splits(self) -> tuple[str, ...]:
        """The names of all splits, in order."""
        return BASE_SPLITS + self.shifts

    def is_in_pieces(self, split: str) -> bool:
        """Return whether the episodes of a split are pieces of routes."""
        return self.pieces > 0 and split != "random"

    @property
    def name(self) -> str:
        """The name of the config on the Hub and of the folder, such as `5x5-key_and_door`."""
        suffix = "" if self.task is Task.NAVIGATION else f"-{self.task}"
        return f"{self.height}x{self.width}{suffix}"

    def to_json(self) -> dict[str, Any]:
        """Return the options in plain types; `from_json` is the inverse.

        Newer options are left out at their defaults, as in datasets that are older than these.
        """
        lists = {"buckets": list(self.buckets), "shifts": list(self.shifts)}
        plain = asdict(self) | {"task": str(self.task)} | lists
        return {name: plain[name] for name in plain if plain[name] != _NEWER.get(name)}

    @classmethod
    def from_json(cls, values: Mapping[str, Any]) -> DatasetConfig:
        """Return the config that `to_json` described.

        Raises:
            ValueError: A field is missing, unknown, of the wrong type, or impossible.
        """
        plain = _NEWER | dict(values)
        shifts = plain.pop("shifts")
        named = isinstance(shifts, list) and all(isinstance(name, str) for name in shifts)
        if _types(plain) != _TYPES or not named:
            fields = [*_TYPES, "shifts"]
            raise ValueError(f"a dataset's config has the fields {fields}, not {values}")
        task, tasks = plain.pop("task"), [str(task) for task in Task]
        if task not in tasks:
            raise ValueError(f"task={task}: choose one of [{', '.join(tasks)}]")
        buckets = tuple(plain.pop("buckets"))
        return cls(task=Task(task), buckets=buckets, shifts=tuple(shifts), **plain)


_NEWER: dict[str, Any] = {
    "min_walls": 1,
    "shifts": [],
    "noise": 0.0,
    "pieces": 0,
    "goals": "fixed",
}
"""The options that datasets of earlier versions lack, with what they stand for there."""

_IN_JSON = {Task: str, tuple[int, int, int]: [int, int, int]}
_TYPES = {
    name: _IN_JSON.get(kind, kind)
    for name, kind in get_type_hints(DatasetConfig).items()
    if name != "shifts"
}
"""Field of the JSON object -> its type, for a list of fixed length the types of its items."""


def _types(values: Mapping[str, Any]) -> dict[str, Any]:
    return {
        name: [type(item) for item in value] if isinstance(value, list) else type(value)
        for name, value in values.items()
    }

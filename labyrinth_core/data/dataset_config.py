"""What a dataset is made of: its splits, and the options that determine its rows.

Every dataset has six splits, and may add shifts. A shift changes one property and keeps the rest.
Most are derived, labyrinth by labyrinth, from a parent split. Shifts without a parent have
structures of their own, which are never trained on; `pipeline.generation.shifts` says how these are
selected.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import MISSING, asdict, dataclass, field, fields
from typing import Any, ClassVar, NamedTuple, get_args, get_type_hints

from labyrinth_core.language import parse_size
from labyrinth_core.pictures import MAX_PICTURED_SIDE, PICTURE_SIZE, usual_wall_pixels
from labyrinth_core.world import ALGORITHMS, Look, Structure, Task


class Refusal(NamedTuple):
    """An option of a dataset with which a shift makes no sense."""

    option: str
    """A field or property of `DatasetConfig`."""
    refuses: Callable[[Any], bool]
    """Returns whether the shift makes no sense with the given value."""
    reason: str


@dataclass(frozen=True)
class Split:
    """A kind of split. `new_start` to `look` say how its labyrinths differ from their parents."""

    number: int
    """The split's part of every random key: another number would change published bytes."""
    meaning: str
    bucket: str
    """The split that its structures' hashes select: train, validation or test. A shift may not have
    structures of train's bucket that its parent lacks, as other datasets train on them."""
    parent: str | None = None
    """The split it is derived from: at most one labyrinth for each parent, in the same order."""
    new_start: bool = False
    new_goal: bool = False
    new_structure: bool = False
    """Whether its structures are others, made as `pipeline.generation.labyrinths` says."""
    look: Look = Look.PLAIN
    refusals: tuple[Refusal, ...] = ()
    """The options with which a dataset cannot have this shift."""

    @property
    def is_redrawn(self) -> bool:
        """Whether the split has its parent's labyrinths and routes, and only looks different."""
        return self.look is not Look.PLAIN


def _sampled_by(number: int, sampler: str) -> Split:
    refusal = Refusal("sampler", sampler.__eq__, f"train is sampled by {sampler} already")
    return Split(number, f"other structures, sampled by {sampler}", "test", refusals=(refusal,))


_VARIED_GOALS = Refusal(
    "goals",
    lambda goals: goals == "varied",
    "with goals=varied each labyrinth of test has a start and a goal of its own",
)
_FAR_APART = Refusal(
    "min_walls", lambda walls: walls > 1, "splits.min_walls={} keeps structures farther apart"
)
_NOISE = Refusal(
    "noise",
    lambda noise: noise > 0,
    "with demonstrations.noise the demonstrated route may not be shortest",
)
_NEEDS_LOOPS = Refusal("task", lambda task: bool(task.rules.needs_loops), "{0.rules.needs_loops}")
_NO_LOOPS = Refusal(
    "open_walls", lambda share: share == 0, "with open_walls=0 train has no loops already"
)
_ALL_LOOPS = Refusal(
    "open_walls", lambda share: share == 1, "with open_walls=1 train has all loops already"
)
_THIN = Refusal("wall_pixels", lambda pixels: pixels == 1, "walls are one pixel thick already")


class Splits(dict[str, Split]):
    """Split by name."""

    sampled = ("train", "validation", "test")
    """The splits that every dataset samples structures for."""
    base = (*sampled, "random", "s0", "s0_and_g")
    """The splits that every dataset has."""

    evaluated = ("train", "validation", "test", "s0", "s0_and_g")
    """The splits on which a trained policy is evaluated."""

    not_evaluated = ("random",)
    """The splits with another policy's episodes, in labyrinths of another split."""

    @property
    def shifts(self) -> tuple[str, ...]:
        """The splits that a dataset may add, in the order in which a dataset has them."""
        return tuple(name for name in self if name not in self.base)


SPLITS = Splits(
    {
        "train": Split(0, "demonstrations to learn from", "train"),
        "validation": Split(1, "other structures, to choose a model with", "validation"),
        "test": Split(2, "other structures again, to judge it on", "test"),
        "random": Split(
            3, "a uniformly random policy on the structures of train", "train", "train"
        ),
        "s0": Split(
            4, "the structures of train with another start", "train", "train", new_start=True
        ),
        "s0_and_g": Split(
            5,
            "the structures of train with another start and another goal",
            "train",
            "train",
            new_start=True,
            new_goal=True,
        ),
        "g": Split(6, "the structures of train with another goal", "train", "train", new_goal=True),
        "test_s0": Split(
            7,
            "the structures of test with another start",
            "test",
            "test",
            new_start=True,
            refusals=(_VARIED_GOALS,),
        ),
        "test_g": Split(
            8,
            "the structures of test with another goal",
            "test",
            "test",
            new_goal=True,
            refusals=(_VARIED_GOALS,),
        ),
        "test_s0_and_g": Split(
            9,
            "the structures of test with another start and another goal",
            "test",
            "test",
            new_start=True,
            new_goal=True,
            refusals=(_VARIED_GOALS,),
        ),
        "one_wall": Split(
            10,
            "labyrinths of train with one wall opened or shut, so that the demonstrated route is "
            "blocked or no longer shortest",
            "test",
            "train",
            new_structure=True,
            refusals=(_FAR_APART, _NOISE),
        ),
        "longer": Split(11, "routes longer than the longest of train, on other structures", "test"),
        "trees": Split(
            12, "other structures, without loops", "test", refusals=(_NEEDS_LOOPS, _NO_LOOPS)
        ),
        "open": Split(
            13,
            "other structures, each with more loops than any of train",
            "test",
            refusals=(_ALL_LOOPS,),
        ),
        "wilson": _sampled_by(14, "wilson"),
        "depth_first": _sampled_by(15, "depth_first"),
        "kruskal": _sampled_by(16, "kruskal"),
        "prim": _sampled_by(17, "prim"),
        "recoloured": Split(
            18,
            "the labyrinths and routes of test in other colours",
            "test",
            "test",
            look=Look.RECOLOURED,
        ),
        "thin_walls": Split(
            19,
            "the labyrinths and routes of test with thin walls",
            "test",
            "test",
            look=Look.THIN_WALLS,
            refusals=(_THIN,),
        ),
        "test_new_routes": Split(
            20, "other structures, none with an optimal route that train demonstrates", "test"
        ),
    }
)
"""Every split, by its name."""


def is_of_train(split: str) -> bool:
    """Return whether a split has the labyrinths of train, or at most one derived from each."""
    kind = SPLITS[split]
    return split == "train" or (kind.parent == "train" and not kind.new_structure)


SOLUTIONS = ("shortest", "all_shortest", "all")
"""The sets of routes that a dataset may demonstrate in each labyrinth."""

GOALS = ("fixed", "varied")
"""Start and goal in train, validation and test: in the corners, or drawn for each labyrinth."""


def _option(
    holds: Callable[[Any], bool], allowed: str, *, name: str = "", default: Any = MISSING
) -> Any:
    """Return the field that declares an option.

    Args:
        holds: Returns whether a value is allowed.
        allowed: What to give instead, for the error message.
        name: The name on the command line, if it is not the field's.
        default: The value at which a manifest leaves the option out.
    """
    metadata = {"holds": holds, "allowed": allowed, "name": name}
    return field(default=default, metadata=metadata)


def _limit() -> Any:
    return _option(lambda number: 1 <= number <= 10**9, "give a number from 1 to 10**9")


def _one_of(*words: str, default: Any = MISSING) -> Any:
    return _option(words.__contains__, f"choose one of [{', '.join(words)}]", default=default)


@dataclass(frozen=True)
class DatasetConfig:
    """The options that determine the rows of a dataset, and no others.

    A manifest leaves out options that have their defaults.

    Raises:
        ValueError: A value is not allowed; the message names the option, the value and what is
            allowed.
    """

    NAME: ClassVar[re.Pattern[str]] = re.compile(rf"\d+x\d+(-({'|'.join(Task)}))?", re.ASCII)
    """The names of datasets' configs; other folders, such as a build's, have other names."""

    height: int
    width: int
    task: Task
    labyrinths: int = _option(lambda number: number >= 1, "give 1 or more")
    solutions: str = _one_of(*SOLUTIONS)
    solutions_limit: int = _limit()
    random_steps: int = _limit()
    sampler: str = _one_of(*ALGORITHMS)
    open_walls: float = _option(lambda p: 0 <= p <= 1, "give a probability from 0 to 1")
    buckets: tuple[int, int, int] = _option(
        lambda shares: len(shares) == 3 and min(shares) >= 1 and sum(shares) == 100,
        "give three percentages of 1 or more that add up to 100",
    )
    """The percentages of all structures that may be in train, validation and test."""
    seed: int = _option(lambda seed: 0 <= seed < 2**64, "give 0 or more, below 2**64")
    min_walls: int = field(default=1, metadata={"name": "splits.min_walls"})
    """Structures of different splits differ in at least this many walls."""
    shifts: tuple[str, ...] = ()
    """The splits besides the six that every dataset has, in the order of `SPLITS.shifts`."""
    noise: float = _option(
        lambda p: 0 <= p < 1,
        "give a probability from 0 to below 1",
        name="demonstrations.noise",
        default=0.0,
    )
    """The probability with which a demonstrator takes a uniformly random action."""
    goals: str = _one_of(*GOALS, default="fixed")
    """Where start and goal of train, validation and test lie, one of `GOALS`."""

    def __post_init__(self) -> None:
        size = f"{self.height}x{self.width}"
        parse_size(size)
        if max(self.height, self.width) > MAX_PICTURED_SIDE:
            raise ValueError(
                f"size={size}: {MAX_PICTURED_SIDE} rows and columns at most fit the datasets' "
                f"pictures of {PICTURE_SIZE} x {PICTURE_SIZE} pixels"
            )
        for option in fields(self):
            if "holds" in option.metadata and not option.metadata["holds"](
                getattr(self, option.name)
            ):
                raise ValueError(f"{self.given(option.name)}: {option.metadata['allowed']}")
        if self.noise and self.solutions != "shortest":
            raise ValueError(
                f"{self.given('noise')}: give solutions=shortest, not {self.solutions}"
            )
        self.task.check_open_walls(self.open_walls)
        passages = 2 * self.height * self.width - self.height - self.width
        if not 1 <= self.min_walls <= passages:
            raise ValueError(
                f"{self.given('min_walls')}: give 1 to {passages}, the most walls that "
                f"{size} can have"
            )
        if self.shifts != tuple(name for name in SPLITS.shifts if name in self.shifts):
            raise ValueError(
                f"{self.given('shifts')}: choose from [{', '.join(SPLITS.shifts)}], each once and "
                "in this order"
            )
        for name in self.shifts:
            if reason := self.why_no(name):
                raise ValueError(f"shifts: {name} is not possible: {reason}")

    def why_no(self, shift: str) -> str | None:
        """Return why a shift makes no sense with the other options; None if it makes sense."""
        for option, refuses, reason in SPLITS[shift].refusals:
            if refuses(value := getattr(self, option)):
                return reason.format(value)
        return None

    def given(self, name: str) -> str:
        """Return an option as written on the command line, such as `splits.min_walls=2`."""
        value = getattr(self, name)
        shown = f"[{','.join(map(str, value))}]" if isinstance(value, tuple) else value
        return f"{_COMMAND_LINE[name]}={shown}"

    def unusual_options(self) -> dict[str, Any]:
        """Return the options that have a default and differ from it.

        The keys are the names on the command line, such as `splits.min_walls`.
        """
        values = {name: getattr(self, name) for name in _DEFAULTS}
        return {_COMMAND_LINE[n]: value for n, value in values.items() if value != _DEFAULTS[n]}

    def bucket_of(self, structure: Structure) -> str | None:
        """Return which of train, validation and test may hold a structure; None if none may."""
        if self.goals == "fixed":
            return structure.split(self.buckets)
        return structure.split_at_any_ends(self.buckets)

    @property
    def wall_pixels(self) -> int:
        """The thickness of walls in the dataset's pictures, in pixels."""
        return usual_wall_pixels(self.height, self.width)

    @property
    def splits(self) -> tuple[str, ...]:
        """The names of all splits, in order."""
        return SPLITS.base + self.shifts

    @property
    def name(self) -> str:
        """The name of the config on the Hub and of the folder, such as `5x5-key_and_door`."""
        suffix = "" if self.task is Task.NAVIGATION else f"-{self.task}"
        return f"{self.height}x{self.width}{suffix}"

    def to_json(self) -> dict[str, Any]:
        """Return the options in plain types; `from_json` is the inverse.

        Options that have their defaults are left out.
        """
        plain = asdict(self) | {"task": str(self.task)}
        return {
            name: list(value) if isinstance(value, tuple) else value
            for name, value in plain.items()
            if value != _DEFAULTS.get(name)
        }

    @classmethod
    def from_json(cls, values: Mapping[str, Any]) -> DatasetConfig:
        """Return the config that `to_json` described.

        Raises:
            ValueError: A field is missing, unknown, of the wrong type, or not allowed.
        """
        plain: dict[str, Any] = {
            name: tuple(value) if isinstance(value, list) else value
            for name, value in (_DEFAULTS | dict(values)).items()
        }
        check_fields(plain, _KINDS, "a dataset's config")
        tasks = [str(task) for task in Task]
        if plain["task"] not in tasks:
            raise ValueError(f"task={plain['task']}: choose one of [{', '.join(tasks)}]")
        return cls(**plain | {"task": Task(plain["task"])})


_DEFAULTS = {e.name: e.default for e in fields(DatasetConfig) if e.default is not MISSING}
"""The options that a manifest leaves out at their defaults."""

_COMMAND_LINE = {e.name: e.metadata.get("name") or e.name for e in fields(DatasetConfig)}
"""Field -> its name on the command line."""

_HINTS = get_type_hints(DatasetConfig)
_KINDS = {each.name: _HINTS[each.name] for each in fields(DatasetConfig)} | {"task": str}
"""Field of the JSON object -> type, with tuples for lists."""


def check_fields(values: Any, kinds: Mapping[str, Any], name: str) -> None:
    """Check the fields and types of an object from JSON whose lists have become tuples.

    Raises:
        ValueError: A field is missing, unknown or of another type.
    """
    right = isinstance(values, dict) and values.keys() == kinds.keys()
    if not right or not all(_is_a(values[field], kind) for field, kind in kinds.items()):
        raise ValueError(f"{name} must have the fields {', '.join(kinds)}, not {values!r:.300}")


def _is_a(value: object, kind: Any) -> bool:
    """Return whether a JSON value, with tuples for lists, has a type such as those of `_KINDS`."""
    items = get_args(kind)
    if not isinstance(value, tuple) or not items:
        return type(value) is kind
    expected = items[:1] * len(value) if items[-1] is ... else items
    return tuple(map(type, value)) == expected

"""The rules of the world: sizes, tasks with their tiles, looks, actions, states and rewards.

A move into a wall leaves the agent where it is and costs a step, whatever lies behind the wall.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum, StrEnum
from functools import cached_property
from typing import NamedTuple

SIDES = range(2, 1_001)
"""The heights and widths allowed; the largest limits the time and memory that text can cost."""


class LabyrinthError(ValueError):
    """A labyrinth breaks a rule of its task; `cell` is the cell at fault, or None."""

    def __init__(self, message: str, cell: int | None = None) -> None:
        super().__init__(message)
        self.cell = cell


class Tile(NamedTuple):
    """A kind of cell that a task adds to a labyrinth."""

    name: str
    """Its field of `Labyrinth`, its colour in `pictures.style.Style`, and its column in the
    report."""
    letter: str
    """How the text language draws it."""
    meaning: str
    """What the report's legend says about it."""
    many: bool = False
    """Whether any number of cells are of this kind, a set, instead of exactly one cell."""


@dataclass(frozen=True)
class TaskRules:
    """What all rooms need to know about a task.

    How its tiles are placed is in `tasks.PLACEMENTS`. A task that changes which moves are possible
    also changes `Labyrinth.transition` and `batch.Labyrinths.transitions`, and `world.js` for the
    report.
    """

    setting: str = ""
    """The setting of the text language that switches the task on; navigation has none."""
    tiles: tuple[Tile, ...] = ()
    owned: str = ""
    """The tiles in words, and how many of them the task needs, for error messages."""
    question: str = ""
    """The rule as questions state it; `{name}` stands for what the agent sees of a tile."""
    phases: int = 1
    """The number of states of the world for each cell of the agent: 3 with a door (locked, key
    held, open)."""
    barrier: str = ""
    """What may stop a move besides walls, as scores of written routes name it; empty if nothing."""
    hides: bool = False
    """Whether the agent sees only some of the cells."""
    is_reversible: bool = True
    """Whether an agent can go back by the way it came, ice excepted."""
    needs_loops: str = ""
    """Why no tree can hold the task; empty if some can."""
    needs_walls: str = ""
    """Why no grid without walls can hold the task; empty if some can."""

    @cached_property
    def singles(self) -> tuple[str, ...]:
        """The names of the tiles of which a labyrinth has exactly one."""
        return tuple(tile.name for tile in self.tiles if not tile.many)

    @cached_property
    def positions(self) -> int:
        """The number of positions in a vector: agent, start and goal, then the single tiles."""
        return 3 + len(self.singles)

    @cached_property
    def grounds(self) -> tuple[str, ...]:
        """The names of the tiles that any number of cells show."""
        return tuple(tile.name for tile in self.tiles if tile.many)


_NO_TILES = TaskRules()


class Task(StrEnum):
    """The difficulty on the way to the goal; a labyrinth has exactly one task."""

    rules: TaskRules

    def __new__(cls, name: str, rules: TaskRules = _NO_TILES) -> Task:
        task = str.__new__(cls, name)
        task._value_, task.rules = name, rules
        return task

    NAVIGATION = "navigation"
    PARTIAL_OBSERVABILITY = "partial_observability", TaskRules("occlusion", hides=True)
    KEY_AND_DOOR = (
        "key_and_door",
        TaskRules(
            "key_and_lock",
            (Tile("key", "K", "key"), Tile("door", "D", "door")),
            "a key and a door, and needs both",
            " The door ({door}) opens to an agent that has been on the key ({key}).",
            phases=3,
            barrier="door",
            is_reversible=False,
            needs_walls="without walls every door can be bypassed",
        ),
    )
    ICY_FLOOR = (
        "icy_floor",
        TaskRules(
            "icy_floor",
            (Tile("ice", "I", "ice, which ends the episode", many=True),),
            "ice, and needs some",
            " Ice ({ice}) must not be entered.",
            needs_loops="without loops ice has no detour",
        ),
    )

    def check_open_walls(self, open_walls: float) -> None:
        """Refuse a share of open walls with which no labyrinth can hold the task.

        Args:
            open_walls: The probability of opening each wall that the tree leaves.

        Raises:
            LabyrinthError: No labyrinth can hold the task.
        """
        wish = f"open_walls={open_walls:g} task={self}"
        if self.rules.needs_loops and open_walls == 0:
            raise LabyrinthError(f"{wish}: {self.rules.needs_loops}; give more than 0")
        if self.rules.needs_walls and open_walls == 1:
            raise LabyrinthError(f"{wish}: {self.rules.needs_walls}; give less than 1")


TILES = tuple(tile for task in Task for tile in task.rules.tiles)
"""The tiles of all tasks."""


class Look(StrEnum):
    """How images of a labyrinth are drawn; nothing else depends on it."""

    PLAIN = "plain"
    RECOLOURED = "recoloured"
    THIN_WALLS = "thin_walls"


class _Numbers(NamedTuple):
    goal_reward: float = 1.0
    ice_reward: float = -100.0
    step_penalty: float = 0.1
    """The cost of a step that does not end on the goal, before division by the number of cells."""
    step_limit: int = 40
    """The number of steps per cell after which an episode is truncated; its return is then -4."""


RULES = _Numbers()
"""The numbers in the rules of every task."""


class Action(IntEnum):
    """The four moves of an agent; `UP` increases the row, and points up in images."""

    UP = 0
    RIGHT = 1
    DOWN = 2
    LEFT = 3


class State(NamedTuple):
    """The part of the world that changes during an episode."""

    agent: int
    """The agent's cell."""
    has_key: bool = False
    door_open: bool = False

"""`Structure` and `Labyrinth`: what they are, which ones are valid, and their ids.

A cell is an integer, `row * width + column`; row 0 is at the bottom and column 0 on the left. A bit
set over cells is an integer whose bit `c`, counted from the lowest, stands for cell `c`.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, fields
from enum import StrEnum
from functools import cached_property
from math import inf
from numbers import Integral
from operator import index
from typing import NamedTuple

MIN_SIDE = 2
MAX_SIDE = 1_000
"""The largest height and width; it limits the time and memory that untrusted text can cost."""


def digits(bits: int, cells: int) -> str:
    """Return a bit set as text, a digit per cell in order: 1 if the cell is in the set, else 0."""
    return f"{bits:0{cells}b}"[::-1]


def bit_set(digits: str) -> int:
    """Return the bit set that a string of digits 0 and 1 describes; the inverse of `digits`."""
    return int(digits[::-1], 2)


def vertical_edges(height: int, width: int) -> int:
    """Return the bit set of the cells with a neighbour above: all but the top row."""
    return (1 << (height - 1) * width) - 1


def horizontal_edges(height: int, width: int) -> int:
    """Return the bit set of the cells with a neighbour to the right: all but the last column."""
    row = (1 << width - 1) - 1
    return row * (((1 << height * width) - 1) // ((1 << width) - 1))


def whole(
    name: str, value: object, least: float = -inf, most: float = inf, *, allowed: str = ""
) -> int:
    """Return an integer of Python or NumPy as a Python `int`, which cannot overflow.

    Args:
        name: The name of the argument, for the message.
        value: Its value.
        least: The smallest number allowed.
        most: The largest number allowed.
        allowed: What the message says is allowed, if these bounds do not say it all.

    Raises:
        ValueError: The value has another type, such as `bool`, or is out of bounds.
    """
    number = value if type(value) is int else None
    if number is None and isinstance(value, Integral) and not isinstance(value, bool):
        with suppress(TypeError):  # NumPy's `timedelta64` counts as Integral, but is no index.
            number = index(value)
    if number is not None and least <= number <= most:
        return number
    bounds = f" from {least} on" if most == inf else f" from {least} to {most}"
    allowed = allowed or f"a whole number{'' if least == -inf else bounds}"
    raise ValueError(f"{name}={value!r:.60}: give {allowed}")


def checked_sides(height: object, width: object) -> tuple[int, int]:
    """Return the height and width of a labyrinth as Python ints.

    Raises:
        ValueError: One of them is not an integer from 2 to 1,000.
    """
    return whole("height", height, MIN_SIDE, MAX_SIDE), whole("width", width, MIN_SIDE, MAX_SIDE)


UNREACHABLE = -1
"""The distance of a state from which the goal cannot be reached."""

Moves = tuple[int, int, int, int]
"""The cells, or states, that the four actions lead to: up, right, down, left."""


class LabyrinthError(ValueError):
    """A labyrinth breaks a rule of its task; `cell` is the cell at fault, or None."""

    def __init__(self, message: str, cell: int | None = None) -> None:
        super().__init__(message)
        self.cell = cell


class Tile(NamedTuple):
    """A kind of cell that a task adds to a labyrinth."""

    name: str
    """Its field of `Labyrinth`, its colour in `pictures.renderer.Style`, and its column in the
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
    also changes `dynamics.transition` and `batch.Labyrinths.transitions`, and `world.js` for the
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


TILES = tuple(tile for task in Task for tile in task.rules.tiles)
"""The tiles of all tasks."""


class Look(StrEnum):
    """How images of a labyrinth are drawn; nothing else depends on it."""

    PLAIN = "plain"
    RECOLOURED = "recoloured"
    THIN_WALLS = "thin_walls"


@dataclass(frozen=True, order=True)
class Structure:
    """The open passages between neighbouring cells of a grid; instances sort by their fields."""

    height: int
    width: int
    up: int
    """The bit set of the cells with a passage to the cell above."""
    right: int
    """The bit set of the cells with a passage to the cell on the right."""

    def __post_init__(self) -> None:
        height, width = checked_sides(self.height, self.width)
        object.__setattr__(self, "height", height)
        object.__setattr__(self, "width", width)
        if self.up & ~vertical_edges(self.height, self.width):
            raise ValueError("up: a passage leads out of the grid")
        if self.right & ~horizontal_edges(self.height, self.width):
            raise ValueError("right: a passage leads out of the grid")

    @classmethod
    def without_walls(cls, height: int, width: int) -> Structure:
        """Return the structure in which every passage of the grid is open."""
        sides = checked_sides(height, width)
        return cls(*sides, vertical_edges(*sides), horizontal_edges(*sides))

    @classmethod
    def from_passages(
        cls, height: int, width: int, passages: Iterable[tuple[int, int]]
    ) -> Structure:
        """Return the structure whose passages join the given pairs of neighbouring cells.

        Raises:
            ValueError: A pair is not two neighbouring cells, or the height or width is not allowed.
        """
        height, width = checked_sides(height, width)
        up, right = ["0"] * (height * width), ["0"] * (height * width)
        for pair in passages:
            low, high = sorted(pair)
            beside = (high - low == 1 and high % width) or high - low == width
            if low < 0 or high >= height * width or not beside:
                raise ValueError(f"cells {pair} of a {height}x{width} grid are not neighbours")
            (up if high - low == width else right)[low] = "1"
        return cls(height, width, bit_set("".join(up)), bit_set("".join(right)))

    @classmethod
    def from_bytes(cls, height: int, width: int, data: bytes) -> Structure:
        """Return the structure with the passages in `data`; the inverse of `to_bytes`."""
        bits, cells = int.from_bytes(data, "little"), height * width
        return cls(height, width, bits & (1 << cells) - 1, bits >> cells)

    def to_bytes(self) -> bytes:
        """Return the bits of `up`, then of `right`, lowest bit first, padded with zeros."""
        bits = self.right << self.cells | self.up
        return bits.to_bytes(-(-2 * self.cells // 8), "little")

    def __reduce__(self) -> tuple[object, ...]:
        return Structure, (self.height, self.width, self.up, self.right)

    @property
    def cells(self) -> int:
        """The number of cells."""
        return self.height * self.width

    @cached_property
    def moves(self) -> list[Moves]:
        """For each cell, the cells that the actions lead to; a wall leads back to the cell."""
        width = self.width
        up, right = digits(self.up, self.cells), digits(self.right, self.cells)
        # The last digits are always 0, so an index below 0 finds no passage.
        return [
            (
                cell + width if up[cell] == "1" else cell,
                cell + 1 if right[cell] == "1" else cell,
                cell - width if up[cell - width] == "1" else cell,
                cell - 1 if right[cell - 1] == "1" else cell,
            )
            for cell in range(self.cells)
        ]

    def passages(self) -> Iterator[tuple[int, int]]:
        """Yield each passage once, as `(cell, neighbour above or on the right)`."""
        for cell, (above, beside, _, _) in enumerate(self.moves):
            if above != cell:
                yield cell, above
            if beside != cell:
                yield cell, beside

    @property
    def loops(self) -> int:
        """The number of passages beyond those of a spanning tree."""
        return self.up.bit_count() + self.right.bit_count() - self.cells + 1

    @property
    def junctions(self) -> int:
        """The number of cells with three or four passages."""
        up, right = self.up, self.right
        down, left = up << self.width, right << 1
        return (up & right & (down | left) | down & left & (up | right)).bit_count()

    @property
    def dead_ends(self) -> int:
        """The number of cells with one passage."""
        up, right = self.up, self.right
        down, left = up << self.width, right << 1
        # Of three passages, two are up and right, or down and left.
        return ((up ^ right ^ down ^ left) & ~(up & right | down & left)).bit_count()

    def distances(self, source: int, blocked: Collection[int] = ()) -> list[int]:
        """Return the least number of moves from `source` to each cell, avoiding `blocked` cells.

        The distance is `UNREACHABLE` for cells that cannot be reached.
        """
        return breadth_first(self.moves, [source], blocked)

    @property
    def is_connected(self) -> bool:
        """Whether every cell can be reached from every other."""
        return UNREACHABLE not in self.distances(0)

    @cached_property
    def structure_id(self) -> str:
        """The structure's hash, 16 hexadecimal digits that fit an int64; stable across machines."""
        return identity(f"{self.height}x{self.width}:{self.up:x}:{self.right:x}")

    def transposed(self) -> Structure:
        """Return the reflection in the diagonal through cell 0: rows become columns."""

        def transpose(bits: int) -> int:
            text = digits(bits, self.cells)
            return bit_set("".join([text[column :: self.width] for column in range(self.width)]))

        return Structure(self.width, self.height, transpose(self.right), transpose(self.up))

    def mirrored(self) -> Structure:
        """Return the reflection that exchanges left and right."""

        def mirror(bits: int) -> int:
            text = digits(bits, self.cells)
            rows = range(0, self.cells, self.width)
            return bit_set("".join([text[row : row + self.width][::-1] for row in rows]))

        # A passage belongs to the cell on its left, which the reflection puts on its right.
        return Structure(self.height, self.width, mirror(self.up), mirror(self.right << 1))

    def symmetries(self) -> list[Structure]:
        """Return the eight rotations and reflections, this structure first; some may be equal."""
        images: list[Structure] = [self]
        # Applying the two reflections in turn goes through all eight once.
        step: Callable[[Structure], Structure]
        for step in [Structure.transposed, Structure.mirrored] * 4:
            images.append(step(images[-1]))
        return images[:8]

    def canonical(self) -> Structure:
        """Return the smaller of the structure and its transpose, comparing height, width, passages.

        The transpose is the reflection that keeps the default start and goal in place.
        """
        return min(self, self.transposed())


def breadth_first(
    successors: Sequence[Sequence[int]],
    sources: Iterable[int],
    blocked: Collection[int] = (),
) -> list[int]:
    """Return the number of steps from the nearest source to each node, or `UNREACHABLE`.

    Args:
        successors: For each node, the nodes one step away.
        sources: The nodes at distance 0.
        blocked: The nodes that are never entered.
    """
    distance = [UNREACHABLE] * len(successors)
    queue = list(sources)
    for node in queue:
        distance[node] = 0
    for node in blocked:
        distance[node] = 0  # Marked as visited until the search is over.
    for node in queue:  # The queue grows during the loop.
        steps = distance[node] + 1
        for successor in successors[node]:
            if distance[successor] < 0:
                distance[successor] = steps
                queue.append(successor)
    for node in blocked:
        distance[node] = UNREACHABLE
    return distance


def identity(text: str) -> str:
    """Return 63 bits of the BLAKE2b hash of a text, as sixteen hexadecimal digits."""
    digest = hashlib.blake2b(text.encode(), digest_size=8).digest()
    return f"{int.from_bytes(digest, 'big') >> 1:016x}"


_WITH_TILES = [(t, t.rules.singles, t.rules.grounds) for t in Task if t.rules.tiles]
_SINGLES = ("start", "goal", *(tile.name for tile in TILES if not tile.many))
_GROUNDS = tuple(tile.name for tile in TILES if tile.many)


@dataclass(frozen=True)
class Labyrinth:
    """A structure with a start, a goal, and a task with its tiles. Cells are indices.

    Every instance is solvable and keeps the rules of its task.

    Raises:
        LabyrinthError: The labyrinth is not solvable or breaks a rule; checked at construction.
    """

    structure: Structure
    start: int
    goal: int
    task: Task = Task.NAVIGATION
    key: int | None = None
    door: int | None = None
    ice: frozenset[int] = frozenset()
    look: Look = Look.PLAIN

    def __post_init__(self) -> None:
        self._make_whole()
        own = vars(self)
        for task, singles, grounds in _WITH_TILES:
            needed = task is self.task
            wrong = bool(grounds) and any(map(own.__getitem__, grounds)) is not needed
            for name in singles:
                wrong = wrong or (own[name] is not None) is not needed
            if wrong:
                raise LabyrinthError(f"only {task} has {task.rules.owned}")
        cells = self.structure.cells
        taken: dict[int, str] = {}
        tiles = [("start", self.start), ("goal", self.goal)]
        if self.task.rules.tiles:
            tiles += self.tiles()
        for name, cell in tiles:
            if not 0 <= cell < cells:
                raise LabyrinthError(f"the {name} is outside the grid: cell {cell}")
            if cell in taken:
                raise LabyrinthError(f"the {taken[cell]} and the {name} share a cell", cell)
            taken[cell] = name
        self._check_solvable()

    def __reduce__(self) -> tuple[object, ...]:
        return Labyrinth, tuple(getattr(self, each.name) for each in fields(self))

    def _make_whole(self) -> None:
        """Convert NumPy integers to ints and texts to enum members; refuse all other types."""
        for name, kind in (("task", Task), ("look", Look)):
            value = getattr(self, name)
            if type(value) is not kind:
                if value not in [*kind]:
                    raise LabyrinthError(f"{name}={value}: choose one of {', '.join(kind)}")
                object.__setattr__(self, name, kind(value))
        for name in _SINGLES:
            cell = getattr(self, name)
            if type(cell) is not int and cell is not None:
                object.__setattr__(self, name, whole(name, cell))
        for name in _GROUNDS:
            cells = getattr(self, name)
            if type(cells) is not frozenset or any(type(cell) is not int for cell in cells):
                object.__setattr__(self, name, frozenset(whole(name, cell) for cell in cells))

    def tiles(self) -> Iterator[tuple[str, int]]:
        """Yield the name and the cell of each tile of the task."""
        for tile in self.task.rules.tiles:
            cells = getattr(self, tile.name)
            if tile.many:
                yield from ((tile.name, cell) for cell in cells)
            elif cells is not None:
                yield tile.name, cells

    @cached_property
    def cell_distances(self) -> Sequence[int]:
        """The least number of moves from each cell to the goal, avoiding ice; the door is open."""
        return self.structure.distances(self.goal, self.ice)

    def _check_solvable(self) -> None:
        structure, door = self.structure, self.door
        if self.cell_distances[self.start] == UNREACHABLE:
            without = " without ice" if self.ice else ""
            raise LabyrinthError(f"no route{without} leads from start to goal", self.goal)
        if self.key is not None and door is not None:
            before_door = structure.distances(self.start, [door])
            if before_door[self.goal] != UNREACHABLE:
                raise LabyrinthError("a route from start to goal avoids the door", door)
            if before_door[self.key] == UNREACHABLE:
                raise LabyrinthError("the key cannot be reached without passing the door", self.key)

    @property
    def size_name(self) -> str:
        """The height and the width, such as `4x6`."""
        return f"{self.structure.height}x{self.structure.width}"

    def position(self, cell: int) -> tuple[int, int]:
        """Return the `(row, column)` of a cell."""
        return divmod(cell, self.structure.width)


class Sketch(Labyrinth):
    """What a drawing shows, only to be drawn: it may lack tiles, or have no route to the goal."""

    def __post_init__(self) -> None:
        self._make_whole()

"""Structures and labyrinths: their definition, their validity, and their identity."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, fields, replace
from enum import StrEnum
from functools import cached_property
from typing import NamedTuple

from labyrinth_core.world.grid import (
    MAX_SIDE,
    MIN_SIDE,
    bit_set,
    digits,
    horizontal_edges,
    neighbours,
    vertical_edges,
)

UNREACHABLE = -1
"""The distance of a state from which the goal cannot be reached."""

Moves = tuple[int, int, int, int]
"""The cells that the four actions lead to from a cell: up, right, down, left."""


class LabyrinthError(ValueError):
    """A labyrinth that breaks a rule of its task; `cell` is the cell at fault, if it is one."""

    def __init__(self, message: str, cell: int | None = None) -> None:
        super().__init__(message)
        self.cell = cell


class Task(StrEnum):
    """The difficulty on the way to the goal; a labyrinth has exactly one task."""

    NAVIGATION = "navigation"
    PARTIAL_OBSERVABILITY = "partial_observability"
    KEY_AND_DOOR = "key_and_door"
    ICY_FLOOR = "icy_floor"


class Look(StrEnum):
    """How the pictures of a labyrinth are drawn; nothing else depends on it."""

    PLAIN = "plain"
    RECOLOURED = "recoloured"
    THIN_WALLS = "thin_walls"


class State(NamedTuple):
    """The part of the world that changes during an episode."""

    agent: int
    """The agent's cell."""
    has_key: bool = False
    door_open: bool = False


@dataclass(frozen=True)
class Structure:
    """The open passages between neighbouring cells of a grid."""

    height: int
    width: int
    up: int
    """The bit set of the cells with a passage to the cell above."""
    right: int
    """The bit set of the cells with a passage to the cell at the right."""

    def __post_init__(self) -> None:
        if not (MIN_SIDE <= self.height <= MAX_SIDE and MIN_SIDE <= self.width <= MAX_SIDE):
            raise ValueError(
                f"a structure has {MIN_SIDE} to {MAX_SIDE:,} rows and columns, "
                f"not {self.height}x{self.width}"
            )
        if self.up & ~vertical_edges(self.height, self.width):
            raise ValueError("up: a passage leads out of the grid")
        if self.right & ~horizontal_edges(self.height, self.width):
            raise ValueError("right: a passage leads out of the grid")

    @classmethod
    def without_walls(cls, height: int, width: int) -> Structure:
        """Return the structure that has all passages of a grid."""
        return cls(height, width, vertical_edges(height, width), horizontal_edges(height, width))

    @classmethod
    def from_passages(
        cls, height: int, width: int, passages: Iterable[tuple[int, int]]
    ) -> Structure:
        """Return the structure whose passages join the given pairs of neighbouring cells.

        Raises:
            ValueError: A pair is not one of neighbours.
        """
        up, right = ["0"] * (height * width), ["0"] * (height * width)
        for pair in passages:
            low, high = sorted(pair)
            if low < 0 or high not in neighbours(low, height, width).values():
                raise ValueError(f"cells {pair} of a {height}x{width} grid are no neighbours")
            (up if high - low == width else right)[low] = "1"
        return cls(height, width, bit_set("".join(up)), bit_set("".join(right)))

    def __reduce__(self) -> tuple[object, ...]:
        return Structure, (self.height, self.width, self.up, self.right)

    @property
    def cells(self) -> int:
        """The number of cells."""
        return self.height * self.width

    @cached_property
    def moves(self) -> list[Moves]:
        """The cells that the actions lead to from each cell; a wall leads back to the cell."""
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
        """Yield each passage once, as `(cell, neighbour above or at the right)`."""
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

    def distances(self, source: int, blocked: Collection[int] = ()) -> list[int]:
        """Return the least number of moves from `source` to each cell, avoiding `blocked` cells.

        It is `UNREACHABLE` for cells that cannot be reached.
        """
        return breadth_first(self.moves, [source], blocked)

    def least_moves(self, source: int, target: int) -> int:
        """Return the least number of moves between two cells, or `UNREACHABLE`.

        All cells are flooded at once, as a bit set, which is quicker than `distances`.
        """
        up, right, width = self.up, self.right, self.width
        reached, moves = 1 << source, 0
        while not reached >> target & 1:
            beside = (reached & right) << 1 | reached >> 1 & right
            flooded = reached | (reached & up) << width | reached >> width & up | beside
            if flooded == reached:
                return UNREACHABLE
            reached, moves = flooded, moves + 1
        return moves

    @property
    def is_connected(self) -> bool:
        """Whether every cell can be reached from every other."""
        return UNREACHABLE not in self.distances(0)

    @cached_property
    def structure_id(self) -> str:
        """The structure's hash, sixteen hexadecimal digits: the same everywhere, fits an int64."""
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

        # A passage belongs to the cell at its left, which the reflection puts at its right.
        return Structure(self.height, self.width, mirror(self.up), mirror(self.right << 1))

    def symmetries(self) -> list[Structure]:
        """Return the eight rotations and reflections, this structure first, some equal."""
        images: list[Structure] = [self]
        # The two reflections, applied in turn, go once through all eight.
        step: Callable[[Structure], Structure]
        for step in [Structure.transposed, Structure.mirrored] * 4:
            images.append(step(images[-1]))
        return images[:8]

    def canonical(self) -> Structure:
        """Return the smaller of the structure and its transpose, if that has the same shape.

        The transpose is the reflection that keeps the default start and goal in place.
        """
        if self.height != self.width:
            return self
        image = self.transposed()
        return image if (image.up, image.right) < (self.up, self.right) else self


def breadth_first(
    successors: Sequence[Sequence[int]],
    sources: Iterable[int],
    blocked: Collection[int] = (),
) -> list[int]:
    """Return the number of steps from the sources to each node, `UNREACHABLE` where none lead.

    Args:
        successors: For each node the nodes one step on.
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


@dataclass(frozen=True)
class Labyrinth:
    """A structure with a start, a goal, and a task with its tiles. Cells are indices.

    Every instance can be solved and keeps the rules of its task.

    Raises:
        LabyrinthError: At construction, if the labyrinth breaks one of them.
    """

    structure: Structure
    start: int
    goal: int
    task: Task = Task.NAVIGATION
    key: int | None = None
    door: int | None = None
    ice: frozenset[int] = frozenset()
    look: Look = Look.PLAIN
    agent: State | None = None
    """The state that episodes begin in; None if that is the start, without the key."""

    def __post_init__(self) -> None:
        tiles = [("start", self.start), ("goal", self.goal)]
        locked = self.task is Task.KEY_AND_DOOR
        if (self.key is None) == locked or (self.door is None) == locked:
            raise LabyrinthError(f"a key and a door belong to {Task.KEY_AND_DOOR}, both or none")
        if bool(self.ice) != (self.task is Task.ICY_FLOOR):
            raise LabyrinthError(f"ice belongs to {Task.ICY_FLOOR}, which needs some")
        if self.key is not None and self.door is not None:
            tiles += [("key", self.key), ("door", self.door)]
        tiles += [("ice", cell) for cell in self.ice]
        cells = self.structure.cells
        taken: dict[int, str] = {}
        for name, cell in tiles:
            if not 0 <= cell < cells:
                raise LabyrinthError(f"the {name} is outside the grid: cell {cell}")
            if cell in taken:
                raise LabyrinthError(f"the {taken[cell]} and the {name} share a cell", cell)
            taken[cell] = name
        self._check_solvable()
        if self.agent == State(self.start):
            object.__setattr__(self, "agent", None)
        if self.agent is not None:
            self._check_agent(*self.agent)

    def __reduce__(self) -> tuple[object, ...]:
        return Labyrinth, tuple(getattr(self, each.name) for each in fields(self))

    @cached_property
    def cell_distances(self) -> Sequence[int]:
        """The least number of moves from each cell to the goal, avoiding ice, with an open door."""
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

    def _check_agent(self, cell: int, has_key: bool, door_open: bool) -> None:
        if not 0 <= cell < self.structure.cells:
            raise LabyrinthError(f"the agent is outside the grid: cell {cell}")
        if has_key and self.key is None:
            raise LabyrinthError(f"a key and an open door belong to {Task.KEY_AND_DOOR}")
        if door_open and not has_key:
            raise LabyrinthError("the door cannot be open if the agent has no key")
        if cell == self.goal or cell in self.ice:
            where = "goal" if cell == self.goal else "ice"
            raise LabyrinthError(f"the agent cannot begin on the {where}, where an episode ends")
        if (cell == self.key and not has_key) or (cell == self.door and not door_open):
            where = "key without it" if cell == self.key else "closed door"
            raise LabyrinthError(f"the agent cannot begin on the {where}")
        distance = self.cell_distances[cell]
        if self.key is not None and self.door is not None and not has_key:
            before_door = self.structure.distances(cell, [self.door])
            distance = max(before_door[self.goal], before_door[self.key])
        if distance == UNREACHABLE:
            without = " without ice" if self.ice else ""
            raise LabyrinthError(f"no route{without} leads from the agent to the goal")

    def from_start(self) -> Labyrinth:
        """Return the labyrinth in which episodes begin on the start."""
        return self if self.agent is None else replace(self, agent=None)

    @property
    def size_name(self) -> str:
        """The height and the width, such as `4x6`."""
        return f"{self.structure.height}x{self.structure.width}"

    def position(self, cell: int) -> tuple[int, int]:
        """Return the `(row, column)` of a cell."""
        return divmod(cell, self.structure.width)

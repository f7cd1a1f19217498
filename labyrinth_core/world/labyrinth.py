"""Structures and labyrinths: what they are, which are valid, when two are the same."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, fields
from enum import Enum
from functools import cached_property, lru_cache
from itertools import product

from labyrinth_core.world.grid import (
    MAX_SIDE,
    MIN_SIDE,
    horizontal_edges,
    neighbours,
    row_and_column,
    vertical_edges,
)

UNREACHABLE = -1
"""Distance of a state from which the goal cannot be reached."""

Moves = tuple[int, int, int, int]
"""Where each action leads from a cell: up, right, down, left."""

_REMEMBERED_CELLS = 1_024
"""Grids of up to so many cells share their moves; all sixteen of a cell take 2 KB."""


class LabyrinthError(ValueError):
    """A labyrinth that breaks a rule of its task; `cell` is the cell at fault, if it is one."""

    def __init__(self, message: str, cell: int | None = None) -> None:
        super().__init__(message)
        self.cell = cell


class Task(str, Enum):
    """What the agent has to cope with on its way to the goal; one at a time."""

    NAVIGATION = "navigation"
    PARTIAL_OBSERVABILITY = "partial_observability"
    KEY_AND_DOOR = "key_and_door"
    ICY_FLOOR = "icy_floor"

    __str__ = str.__str__


@dataclass(frozen=True)
class Structure:
    """The open passages between neighbouring cells of a grid."""

    height: int
    width: int
    up: int
    """Bit set over cells: there is a passage between the cell and the one above it."""
    right: int
    """Bit set over cells: there is a passage between the cell and the one at its right."""

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
    def from_passages(
        cls, height: int, width: int, passages: Iterable[tuple[int, int]]
    ) -> Structure:
        """Return the structure whose passages join the given pairs of neighbouring cells.

        Raises:
            ValueError: A pair is not one of neighbours.
        """
        size = height * width
        up, right = bytearray(b"0") * size, bytearray(b"0") * size
        for pair in passages:
            low, high = sorted(pair)
            if low < 0 or high not in neighbours(low, height, width).values():
                raise ValueError(f"cells {pair} of a {height}x{width} grid are no neighbours")
            (up if high - low == width else right)[-1 - low] = ord("1")
        return cls(height, width, int(up, 2), int(right, 2))

    def __reduce__(self) -> tuple[object, ...]:
        return Structure, (self.height, self.width, self.up, self.right)

    @property
    def cells(self) -> int:
        """The number of cells."""
        return self.height * self.width

    @cached_property
    def moves(self) -> list[Moves]:
        """Where each action leads from each cell; a wall leads back."""
        width, size = self.width, self.cells
        # Four bits a cell, those of its open sides: binary digits, read as if hexadecimal.
        above, beside = int(f"{self.up:b}", 16), int(f"{self.right:b}", 16)
        sides = above << 3 | beside << 2 | above << 4 * width + 1 | beside << 4
        # As text, cell 0 first: reading single bits of a long integer costs its whole length.
        digits = f"{sides:0{size}x}"[::-1]
        if size <= _REMEMBERED_CELLS:
            known = _all_moves(size, width)
            return [moves[digit] for moves, digit in zip(known, digits, strict=True)]
        steps = map(_all_moves(1, width)[0].__getitem__, digits)  # From cell 0: the differences.
        return [
            (c + up, c + right, c + down, c + left)
            for c, (up, right, down, left) in enumerate(steps)
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
        """Passages beyond those of a tree."""
        return self.up.bit_count() + self.right.bit_count() - self.cells + 1

    @property
    def junctions(self) -> int:
        """Cells where ways part: three passages or four lead from them."""
        return sum(ways.count(cell) < 2 for cell, ways in enumerate(self.moves))

    def distances(self, source: int, blocked: Collection[int] = ()) -> list[int]:
        """Return how many moves each cell is from `source`, never entering `blocked` cells.

        Cells that cannot be reached have `UNREACHABLE`.
        """
        return breadth_first(self.moves, [source], blocked)

    @property
    def is_connected(self) -> bool:
        """Whether every cell can be reached from every other."""
        return UNREACHABLE not in self.distances(0)

    @cached_property
    def structure_id(self) -> str:
        """Sixteen hexadecimal digits, the same on every machine; they fit in an int64."""
        return identity(f"{self.height}x{self.width}:{self.up:x}:{self.right:x}")

    def transposed(self) -> Structure:
        """Return the mirror image on the diagonal through cell 0, where rows become columns."""

        def transpose(bits: int) -> int:
            text = f"{bits:0{self.cells}b}"
            return int("".join([text[column :: self.width] for column in range(self.width)]), 2)

        return Structure(self.width, self.height, transpose(self.right), transpose(self.up))

    def mirrored(self) -> Structure:
        """Return the mirror image with left and right exchanged."""

        def mirror(bits: int) -> int:
            text, width = f"{bits:0{self.cells}b}", self.width
            rows = range(0, self.cells, width)
            return int("".join(text[row : row + width][::-1] for row in rows), 2)

        # A passage belongs to the cell at its left, which the mirror puts at its right.
        return Structure(self.height, self.width, mirror(self.up), mirror(self.right << 1))

    def symmetries(self) -> list[Structure]:
        """Return the eight rotations and reflections, this structure first, some equal."""
        images: list[Structure] = [self]
        image = self
        # Reflections on two lines, taken in turn, go once through all eight.
        step: Callable[[Structure], Structure]
        for step in [Structure.transposed, Structure.mirrored] * 4:
            image = step(image)
            images.append(image)
        return images[:8]

    def canonical(self) -> Structure:
        """Return the smaller of the structure and its transpose, if that has the same shape.

        The transpose is the mirror image that keeps the default start and goal in place.
        """
        if self.height != self.width:
            return self
        image = self.transposed()
        return image if (image.up, image.right) < (self.up, self.right) else self


@lru_cache(maxsize=16)
def _all_moves(cells: int, width: int) -> list[dict[str, Moves]]:
    """Return for each cell the moves from it by the hexadecimal digit of its open sides.

    The bits of that digit, the highest first, are those of up, right, down and left.
    """
    return [
        dict(
            zip(
                "0123456789abcdef",
                product((c, c + width), (c, c + 1), (c, c - width), (c, c - 1)),
                strict=True,
            )
        )
        for c in range(cells)
    ]


def breadth_first(
    successors: list[tuple[int, ...]] | list[Moves],
    sources: Iterable[int],
    blocked: Collection[int] = (),
) -> list[int]:
    """Return the number of steps from the sources to each node, `UNREACHABLE` where none lead.

    Args:
        successors: Node -> nodes one step on.
        sources: Nodes at distance 0.
        blocked: Nodes that are never entered.
    """
    distance = [UNREACHABLE] * len(successors)
    queue = list(sources)
    for node in queue:
        distance[node] = 0
    for node in blocked:
        distance[node] = 0  # As if seen already; taken back at the end.
    for node in queue:  # It grows meanwhile.
        steps = distance[node] + 1
        for successor in successors[node]:
            if distance[successor] < 0:
                distance[successor] = steps
                queue.append(successor)
    for node in blocked:
        distance[node] = UNREACHABLE
    return distance


def identity(text: str) -> str:
    """Return sixteen hexadecimal digits for a text: 63 bits of its BLAKE2b hash."""
    digest = hashlib.blake2b(text.encode(), digest_size=8).digest()
    return f"{int.from_bytes(digest, 'big') >> 1:016x}"


@dataclass(frozen=True)
class Labyrinth:
    """A structure with a start, a goal, and a task with its tiles. Cells are indices.

    Whoever holds one knows that it can be solved and that it keeps the rules of its task.

    Raises:
        LabyrinthError: At construction, for a labyrinth that breaks one of them.
    """

    structure: Structure
    start: int
    goal: int
    task: Task = Task.NAVIGATION
    key: int | None = None
    door: int | None = None
    ice: frozenset[int] = frozenset()

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

    def __reduce__(self) -> tuple[object, ...]:
        return Labyrinth, tuple(getattr(self, each.name) for each in fields(self))

    @cached_property
    def cell_distances(self) -> Sequence[int]:
        """The least number of moves from each cell to the goal, off the ice, the door open."""
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
        """The size as people write it, height first, such as `4x6`."""
        return f"{self.structure.height}x{self.structure.width}"

    def position(self, cell: int) -> tuple[int, int]:
        """Return the `(row, column)` of a cell."""
        return row_and_column(cell, self.structure.width)

"""The passages of a labyrinth: `Structure`, its distances, what is visible, and its id.

A cell is an integer, `row * width + column`; row 0 is at the bottom and column 0 on the left. A bit
set over cells is an integer whose bit `c`, counted from the lowest, stands for cell `c`.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import NamedTuple

import numpy as np

from labyrinth_core.checks import whole
from labyrinth_core.world.rules import SIDES, Action
from labyrinth_core.world.sampling import ALGORITHMS, Draws, cells_beside, default_open_walls


class Buckets(NamedTuple):
    """The percentage of all structures that belong to each split."""

    train: int = 34
    validation: int = 33
    test: int = 33


BUCKETS = Buckets()
"""The default percentages; `BUCKETS._fields` are the names of these splits."""

UNREACHABLE = -1
"""The distance of a state from which the goal cannot be reached."""

Moves = tuple[int, int, int, int]
"""The cells, or states, that the four actions lead to: up, right, down, left."""


DIAGONALS = tuple(product((Action.RIGHT, Action.LEFT), (Action.UP, Action.DOWN)))
"""The four diagonals, each as a step sideways, then a step up or down."""


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


def checked_sides(height: object, width: object) -> tuple[int, int]:
    """Return the height and width of a labyrinth as Python ints.

    Raises:
        ValueError: One of them is not an integer from 2 to 1,000.
    """
    least, most = SIDES[0], SIDES[-1]
    return whole("height", height, least, most), whole("width", width, least, most)


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
        if height is not self.height or width is not self.width:
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
    def sample(
        cls,
        height: int,
        width: int,
        rng: np.random.Generator,
        *,
        algorithm: str = "wilson",
        open_walls: float | None = None,
    ) -> Iterator[Structure]:
        """Yield random connected structures forever; a structure can occur more than once.

        Args:
            height: Rows.
            width: Columns.
            rng: The source of all randomness.
            algorithm: How the spanning tree is drawn, a key of `sampling.ALGORITHMS`.
            open_walls: The probability of opening each wall that the tree leaves;
                None for `sampling.default_open_walls`.

        Raises:
            ValueError: The algorithm is unknown, `open_walls` is not a probability, or the height
                or width is not allowed.
        """
        height, width = checked_sides(height, width)
        if algorithm not in ALGORITHMS:
            raise ValueError(f"sampler={algorithm}: choose one of {', '.join(ALGORITHMS)}")
        if open_walls is None:
            open_walls = default_open_walls(height, width)
        if not 0 <= open_walls <= 1:
            raise ValueError(f"open_walls={open_walls}: give a probability from 0 to 1")
        draw_tree = ALGORITHMS[algorithm]
        cells = height * width
        beside = cells_beside(height, width)
        edges = vertical_edges(height, width) | horizontal_edges(height, width) << cells
        draws = Draws(rng)
        while True:
            digits = ["0"] * (2 * cells)  # First the passages up, then the passages to the right.
            for a, b in draw_tree(beside, draws):
                digits[min(a, b) + (0 if abs(b - a) == width else cells)] = "1"
            is_open = bit_set("".join(digits))
            if open_walls:
                coins = np.packbits(rng.random(2 * cells) < open_walls, bitorder="little")
                is_open |= edges & int.from_bytes(coins.tobytes(), "little")
            yield cls(height, width, is_open & (1 << cells) - 1, is_open >> cells)

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

    @property
    def default_ends(self) -> tuple[int, int]:
        """The default start and goal: the bottom left and the top right cell."""
        return 0, self.cells - 1

    def digits(self) -> tuple[str, str]:
        """Return `up` and `right` as text, a digit per cell in order: 1 for a passage, else 0."""
        cells = self.cells
        return digits(self.up, cells), digits(self.right, cells)

    @cached_property
    def moves(self) -> list[Moves]:
        """For each cell, the cells that the actions lead to; a wall leads back to the cell."""
        width = self.width
        up, right = self.digits()
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

    def grid_distance(self, a: int, b: int) -> int:
        """Return the number of moves between two cells if there were no walls."""
        (row_a, column_a), (row_b, column_b) = divmod(a, self.width), divmod(b, self.width)
        return abs(row_a - row_b) + abs(column_a - column_b)

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

    def least_moves(self, source: int, target: int) -> int:
        """Return the least number of moves between two cells, or `UNREACHABLE`.

        A flood fill on bit sets, which is faster than `distances`.
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

    def visible_from(self, cell: int) -> frozenset[int]:
        """Return the cells visible from a cell: straight ahead, diagonally, and the cell itself.

        A diagonal step is unobstructed if the passage sideways, and from there the passage up or
        down, are both open; sideways comes first, as in the authors' code.
        """
        moves = self.moves
        seen = {cell}
        for action in Action:
            at = cell
            while (after := moves[at][action]) != at:
                at = after
                seen.add(at)
        for side, updown in DIAGONALS:
            at = cell
            while (beside := moves[at][side]) != at and (after := moves[beside][updown]) != beside:
                at = after
                seen.add(at)
        return frozenset(seen)

    def free(self) -> None:
        """Free the memory of `moves`, 2 KB at 5x5; they are computed again when asked for."""
        vars(self).pop("moves", None)

    @cached_property
    def structure_id(self) -> str:
        """The structure's hash, 16 hexadecimal digits that fit an int64; stable across machines."""
        return identity(f"{self.height}x{self.width}:{self.up:x}:{self.right:x}")

    def split(self, buckets: Sequence[int]) -> str:
        """Return the split to which it belongs in every dataset: train, validation or test.

        The reflection that keeps the default start and goal is in the same split.

        Args:
            buckets: The percentages of all structures in the three splits.
        """
        percent = int(self.canonical().structure_id, 16) * 100 >> 63
        train, validation, _ = buckets
        if percent < train:
            return "train"
        return "validation" if percent < train + validation else "test"

    def split_at_any_ends(self, buckets: Sequence[int]) -> str | None:
        """Return the split that may hold it with any start and goal; None if it is left out.

        Any rotation or reflection may then give the same labyrinth again. So a structure is allowed
        only if it is in the same split as the smallest of its eight images, a rule that depends on
        nothing else in the dataset.
        """
        split = self.split(buckets)
        return split if min(self.symmetries()).split(buckets) == split else None

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

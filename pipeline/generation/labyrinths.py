"""The structures of a split, as records, and the labyrinth of each in every split.

That is also a labyrinth of a split derived from another one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import fields, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.data import SPLITS, DatasetConfig, Drawing
from labyrinth_core.world import (
    Episode,
    Labyrinth,
    LabyrinthError,
    Placer,
    Solver,
    Structure,
)

UNFIT = -1
"""In place of the split of a candidate that no split can use, or that repeats one in its chunk."""

Records = NDArray[np.void]
"""Structures of one size, shape (n,): the id of each as a number, the index of its split in
`SPLITS.sampled`, and its passages as bits."""


def record_type(config: DatasetConfig) -> np.dtype[np.void]:
    """Return the type of the items of `Records`."""
    passages = Structure.without_walls(config.height, config.width).to_bytes()
    return np.dtype([("id", "<i8"), ("split", "i1"), ("passages", f"V{len(passages)}")])


def pack(config: DatasetConfig, structures: Iterable[tuple[Structure, int]]) -> Records:
    """Return structures, each with the index of its split, as records."""
    items = [(int(each.structure_id, 16), split, each.to_bytes()) for each, split in structures]
    return np.array(items, record_type(config))


def unpack(config: DatasetConfig, records: Records) -> Iterator[Structure]:
    """Yield the structures that records hold."""
    for passages in records["passages"]:
        yield Structure.from_bytes(config.height, config.width, passages.tobytes())


class Solution(NamedTuple):
    """The episodes of one labyrinth, at least one."""

    episodes: list[Episode]
    shortest: tuple[int, int]
    """The number of moves of a shortest route, and the number of such routes."""

    @classmethod
    def of(cls, config: DatasetConfig, split: str, labyrinth: Labyrinth) -> Solution:
        """Return the episodes of a labyrinth in a split, and its shortest routes."""
        solver = Solver(labyrinth)
        return cls(Drawing(config).episodes_by(split, solver), solver.moves_and_routes())

    @property
    def labyrinth(self) -> Labyrinth:
        """The labyrinth, which all episodes share."""
        return self.episodes[0].labyrinth


def labyrinth_and_parent(
    config: DatasetConfig, split: str, structure: Structure
) -> tuple[Labyrinth, Labyrinth | None]:
    """Return the labyrinth of a structure in a split, and its parent, None if it has no parent.

    Args:
        config: The configuration of the dataset.
        split: One of its splits.
        structure: A structure of that split, or of its parent split if it has one.

    Raises:
        LabyrinthError: There is no such labyrinth: the structure cannot hold the task, or has no
            other start or goal for it, or none of its walls can be changed.
    """
    kind, drawing = SPLITS[split], Drawing(config)
    if kind.parent is None:
        return drawing.labyrinth(split, structure), None
    parent = drawing.labyrinth(kind.parent, structure)
    if kind.new_structure:
        made = NEW_STRUCTURES[split].make(config, parent)
        if (bucket := config.bucket_of(made.structure)) != kind.bucket:
            raise LabyrinthError(f"the new structure belongs to {bucket or 'no split'}")
        return made, parent
    if kind.new_start or kind.new_goal:
        placer = Placer(drawing.rng(split, structure))
        if kind.new_start and kind.new_goal:
            return placer.other_ends(parent), parent
        moved = placer.other_start if kind.new_start else placer.other_goal
        return moved(parent), parent
    return (replace(parent, look=kind.look) if kind.is_redrawn else parent), parent


def numbered_labyrinths(
    config: DatasetConfig, split: str, structures: Iterable[tuple[int, Structure]]
) -> Iterator[tuple[int, Labyrinth, Labyrinth | None]]:
    """Yield the labyrinths of numbered structures, each with its number and its parent.

    In a shift, structures without such a labyrinth are left out, and so are labyrinths equal to the
    one before, as two labyrinths of train may have the same twin: their rows would be taken for one
    labyrinth's.
    """
    before = None
    for number, structure in structures:
        try:
            labyrinth, parent = labyrinth_and_parent(config, split, structure)
        except LabyrinthError:
            if split not in SPLITS.shifts:
                raise
            continue
        if labyrinth != before:
            yield number, labyrinth, parent
        before = labyrinth


def twin(config: DatasetConfig, labyrinth: Labyrinth) -> Labyrinth:
    """Return a labyrinth of train with one wall opened or shut; the tiles stay where they are.

    Each wall that `twin_problem` allows is equally likely. The new structure is in the bucket of
    test, so no dataset trains on it.

    Raises:
        LabyrinthError: No wall can be changed in this way.
    """
    structure = labyrinth.structure
    passages = list(_worth_changing(config, labyrinth))
    rng = Drawing(config).rng("one_wall", structure)
    for number in rng.permutation(len(passages)).tolist():
        changed = toggled(structure, *passages[number])
        if config.bucket_of(changed) != "test":
            continue
        try:
            other = replace(labyrinth, structure=changed)
        except LabyrinthError:
            continue
        if twin_problem(config, labyrinth, other) is None:
            return other
    raise LabyrinthError("no wall can be changed so that another route is the shortest")


def twin_problem(config: DatasetConfig, labyrinth: Labyrinth, other: Labyrinth) -> str | None:
    """Return why `other` is not a twin of a labyrinth of train, None if it is."""
    for each in fields(Labyrinth):
        if each.name != "structure" and getattr(other, each.name) != getattr(labyrinth, each.name):
            return f"its {each.name} is not that of its parent"
    mine, others = labyrinth.structure, other.structure
    changed = (mine.up ^ others.up).bit_count() + (mine.right ^ others.right).bit_count()
    if changed != 1:
        return f"{changed} walls differ from its parent, not one"
    solver = Solver(other)
    if not others.is_connected or not solver.tiles_matter:
        return "not every cell can be reached, or the tiles of the task make no difference"
    if Solver(labyrinth).moves != solver.moves:
        return None
    if config.solutions == "shortest":
        for passage in _demonstrated(config, labyrinth):
            if toggled(mine, *passage) == others:
                return None
    return "a demonstrated route is open still, and as short as any"


class NewStructure(NamedTuple):
    """How a shift makes a labyrinth with another structure from a labyrinth of its parent.

    Labyrinths whose structure is not in the shift's `bucket` are left out, since another dataset
    may train on it.
    """

    make: Callable[[DatasetConfig, Labyrinth], Labyrinth]
    """Returns the labyrinth, always the same one, given its parent; raises LabyrinthError if there
    is none."""
    problem: Callable[[DatasetConfig, Labyrinth, Labyrinth], str | None]
    """Returns why a labyrinth, the second one, cannot be made from its parent; None if it can."""


NEW_STRUCTURES = {"one_wall": NewStructure(twin, twin_problem)}
"""Each shift with `new_structure` -> how its labyrinths are made."""


def toggled(structure: Structure, cell: int, beside: int) -> Structure:
    """Return a structure with the passage between two neighbouring cells opened or shut."""
    low, high = min(cell, beside), max(cell, beside)
    up, right = structure.up, structure.right
    if high - low == structure.width:
        up ^= 1 << low
    else:
        right ^= 1 << low
    return Structure(structure.height, structure.width, up, right)


def walls(structure: Structure) -> Iterator[tuple[int, int]]:
    """Return the pairs of neighbouring cells without a passage, the lower cell first."""
    height, width = structure.height, structure.width
    whole = Structure.without_walls(height, width)
    up, right = whole.up ^ structure.up, whole.right ^ structure.right
    return Structure(height, width, up, right).passages()


def _worth_changing(config: DatasetConfig, labyrinth: Labyrinth) -> Iterator[tuple[int, int]]:
    """Yield the pairs of cells between which opening or shutting can change the shortest route.

    Only a passage on the demonstrated route is worth shutting. A wall is worth opening if that
    makes a shorter way to the goal, or, in key and door, perhaps to the key.
    """
    structure = labyrinth.structure
    yield from sorted(set(_demonstrated(config, labyrinth)))
    from_start, to_goal = structure.distances(labyrinth.start), labyrinth.cell_distances
    moves = Solver(labyrinth).moves
    for cell, beside in walls(structure):
        moves_through = from_start[cell] + 1 + to_goal[beside]
        back = from_start[beside] + 1 + to_goal[cell]
        if not labyrinth.task.rules.is_reversible or min(moves_through, back) < moves:
            yield cell, beside


def _demonstrated(config: DatasetConfig, labyrinth: Labyrinth) -> Iterator[tuple[int, int]]:
    """Yield the passages of the shortest route that train demonstrates, the lower cell first."""
    rng = Drawing(config).acting_rng("train", labyrinth.structure)
    cells = [
        state.agent for state in labyrinth.replay(Solver(labyrinth).shortest_route(rng)).states
    ]
    return ((min(pair), max(pair)) for pair in pairwise(cells))

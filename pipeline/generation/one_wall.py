"""The twin of a labyrinth: one wall is changed, and the demonstrated route is not to be taken."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields, replace
from itertools import pairwise

from labyrinth_core.data.dataset_config import DatasetConfig
from labyrinth_core.world.grid import neighbours
from labyrinth_core.world.labyrinth import Labyrinth, LabyrinthError, Structure
from labyrinth_core.world.rollout import replay
from labyrinth_core.world.solver import moves_of, shortest_route
from labyrinth_core.world.tasks import tiles_matter
from pipeline.generation.buckets import bucket_of
from pipeline.generation.randomness import ACTING, item_rng


def twin(config: DatasetConfig, labyrinth: Labyrinth) -> Labyrinth:
    """Return a labyrinth of train with one wall opened or shut; the tiles stay where they are.

    The wall is one of those that `problem` allows, each of them equally likely, and the structure
    is one that no dataset trains on, as those of test.

    Raises:
        LabyrinthError: There is no such wall.
    """
    structure = labyrinth.structure
    passages = list(_worth_changing(config, labyrinth))
    rng = item_rng(config, "one_wall", structure)
    for place in rng.permutation(len(passages)).tolist():
        changed = toggled(structure, *passages[place])
        if bucket_of(config, changed) != "test":
            continue
        try:
            other = replace(labyrinth, structure=changed)
        except LabyrinthError:
            continue
        if problem(config, labyrinth, other) is None:
            return other
    raise LabyrinthError("no wall can be changed so that another route is the shortest")


def problem(config: DatasetConfig, labyrinth: Labyrinth, other: Labyrinth) -> str | None:
    """Return why a labyrinth is no twin of a labyrinth of train, None if it is one."""
    for field in fields(Labyrinth):
        if field.name != "structure" and getattr(other, field.name) != getattr(
            labyrinth, field.name
        ):
            return f"its {field.name} is not that of its parent"
    mine, others = labyrinth.structure, other.structure
    changed = (mine.up ^ others.up).bit_count() + (mine.right ^ others.right).bit_count()
    if changed != 1:
        return f"{changed} walls differ from its parent, not one"
    if not others.is_connected or not tiles_matter(other):
        return "not every cell can be reached, or the tiles of the task make no difference"
    if moves_of(labyrinth) != moves_of(other):
        return None
    if config.solutions == "shortest":
        for passage in _demonstrated(config, labyrinth):
            if toggled(mine, *passage) == others:
                return None
    return "a demonstrated route is open still, and as short as any"


def toggled(structure: Structure, cell: int, beside: int) -> Structure:
    """Return a structure with the passage between two neighbouring cells opened or shut."""
    low, high = min(cell, beside), max(cell, beside)
    up, right = structure.up, structure.right
    if high - low == structure.width:
        up ^= 1 << low
    else:
        right ^= 1 << low
    return Structure(structure.height, structure.width, up, right)


def _worth_changing(config: DatasetConfig, labyrinth: Labyrinth) -> Iterator[tuple[int, int]]:
    """Yield the pairs of cells between which a change can matter.

    A passage to shut is on the demonstrated route. A wall to open leads nearer to the goal, or, in
    key and door, perhaps to the key.
    """
    structure = labyrinth.structure
    yield from sorted(set(_demonstrated(config, labyrinth)))
    from_start, to_goal = structure.distances(labyrinth.start), labyrinth.cell_distances
    moves = moves_of(labyrinth)
    for cell, onward in enumerate(structure.moves):
        for beside in neighbours(cell, structure.height, structure.width).values():
            if beside < cell or beside in onward:
                continue
            there = from_start[cell] + 1 + to_goal[beside]
            back = from_start[beside] + 1 + to_goal[cell]
            if labyrinth.key is not None or min(there, back) < moves:
                yield cell, beside


def _demonstrated(config: DatasetConfig, labyrinth: Labyrinth) -> Iterator[tuple[int, int]]:
    """Yield the passages of the shortest route that train demonstrates, the lower cell first."""
    rng = item_rng(config, "train", labyrinth.structure, ACTING)
    cells = [state.agent for state in replay(labyrinth, shortest_route(labyrinth, rng)).states]
    return ((min(pair), max(pair)) for pair in pairwise(cells))

"""How the labyrinths of a shift relate to those of its parent, for `validate`."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import groupby

from labyrinth_core.data.columns import open_shard, texts
from labyrinth_core.data.dataset_config import DatasetConfig
from labyrinth_core.data.splits import SPLITS
from labyrinth_core.data.storage import AnyPath, local_copy
from labyrinth_core.language.text import parse
from labyrinth_core.world.labyrinth import Labyrinth, LabyrinthError
from pipeline.generation import one_wall
from pipeline.generation.variants import labyrinth_of


@dataclass(frozen=True)
class Parent:
    """A labyrinth of the parent with its episodes."""

    labyrinth: Labyrinth
    routes: list[list[int]]
    """The actions of each episode; the last row of each has none."""


def parents_of(path: AnyPath) -> list[Parent]:
    """Return the labyrinths of a shard with their episodes, in order.

    Raises:
        OSError, ArrowException: The file cannot be read.
        ValueError: A text in it is no labyrinth.
    """
    found: list[Parent] = []
    with local_copy(path) as local, open_shard(local) as file:
        table = file.read(["info", "actions", "episode_starts"])
    rows = zip(
        texts(table["info"]),
        table["actions"].to_pylist(),
        table["episode_starts"].to_pylist(),
        strict=True,
    )
    for info, of_labyrinth in groupby(rows, key=lambda row: row[0]):
        routes: list[list[int]] = []
        for _, action, starts in of_labyrinth:
            if starts or not routes:
                routes.append([])
            routes[-1].append(action)
        found.append(Parent(parse(info or ""), [route[:-1] for route in routes]))
    return found


def relation_problems(
    config: DatasetConfig, split: str, parent: Parent, labyrinth: Labyrinth
) -> Iterator[str]:
    """Yield what a labyrinth of a shift has not of its parent, or has and should not.

    Start, goal and look are those that the split asks for: `rules.labyrinth_problems` sees to that.
    """
    kind = SPLITS[split]
    if kind.new_structure:
        if message := one_wall.problem(config, parent.labyrinth, labyrinth):
            yield message
    elif labyrinth.structure != parent.labyrinth.structure:
        yield f"its structure is not that of its parent in {kind.parent}"
    elif is_redrawn(split) and replace(labyrinth, look=parent.labyrinth.look) != parent.labyrinth:
        yield f"more than its look differs from its parent in {kind.parent}"


def is_redrawn(split: str) -> bool:
    """Return whether a shift has its parent's labyrinths and routes, and only looks different."""
    kind = SPLITS[split]
    changed = kind.new_start or kind.new_goal or kind.new_structure
    return kind.parent is not None and split != "random" and not changed


def is_left_out(config: DatasetConfig, split: str, parent: Parent) -> bool:
    """Return whether a shift has to do without a labyrinth, as it has no such variant."""
    try:
        labyrinth_of(config, split, parent.labyrinth.structure)
    except LabyrinthError:
        return True
    return False

"""How the labyrinths of a shift relate to those of its parent, for `validate`."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import groupby

from labyrinth_core.data.columns import footer_problem, open_shard, texts
from labyrinth_core.data.dataset_config import DatasetConfig
from labyrinth_core.data.errors import one_line
from labyrinth_core.data.manifest import Shard
from labyrinth_core.data.splits import SPLITS
from labyrinth_core.data.storage import AnyPath, local_copy
from labyrinth_core.language.text import parse, without_agent
from labyrinth_core.world.labyrinth import Labyrinth, LabyrinthError
from pipeline.generation import one_wall
from pipeline.generation.variants import labyrinth_of


@dataclass(frozen=True)
class Parent:
    """A labyrinth of the parent with its episodes."""

    labyrinth: Labyrinth
    routes: list[list[int]]
    """The actions of each episode; the last row of each has none."""


class Relations:
    """The labyrinths of a shard of a shift, compared with those that they are made from.

    A labyrinth has the number of its parent in the parent's split, and the pictures' names tell it.
    """

    def __init__(
        self, folder: AnyPath, config: DatasetConfig, shard: Shard, parent: Shard, first: int
    ) -> None:
        """Read the parents.

        Args:
            folder: The folder of the shards.
            config: The configuration of the dataset.
            shard: A shard of the shift.
            parent: The shard of its parent in the same place.
            first: The number of the first labyrinth of `parent` in its split.
        """
        import pyarrow as pa

        self._config, self._shard, self._parent, self._first = config, shard, parent, first
        self._problems: list[str] = []
        self._parents: list[Parent] = []
        try:
            self._parents = parents_of(folder, parent)
        except MemoryError:  # Of Arrow, too; nothing is wrong with the file.
            raise
        except (OSError, ValueError, LookupError, pa.ArrowException) as error:
            reason = f"cannot be compared with {parent.path}, which cannot be read"
            self._problems = [f"{shard.path} {reason}: {one_line(error)}"]
        self._left = set(range(len(self._parents)))
        """The places of the parents that no labyrinth has been made from so far."""

    def numbered(self, path: str, *, least: int) -> int:
        """Return the number in the name of a picture; the least one possible if there is none."""
        named = re.match(rf"{self._shard.split}-(\d{{6,9}})-", path, re.ASCII)
        return max(least, int(named[1])) if named else least

    def of(self, number: int, labyrinth: Labyrinth) -> Iterator[tuple[str, str]]:
        """Yield the column and the message of what is wrong with a labyrinth of the shift."""
        if not self._parents:
            return
        place = number - self._first
        if place not in self._left:
            yield "obs", f"there is no labyrinth {number} in {self._parent.path}"
            return
        self._left.remove(place)
        parent = self._parents[place]
        for message in relation_problems(self._config, self._shard.split, parent, labyrinth):
            yield "info", message

    def allows(self, number: int, routes: list[list[int]]) -> bool:
        """Return whether routes are the parent's, where the shift has to have the same."""
        of_parent = self._parents[number - self._first :][:1]
        return not (is_redrawn(self._shard.split) and of_parent and of_parent[0].routes != routes)

    def problems(self) -> list[str]:
        """Return the problems of the shard as a whole, after all of its labyrinths."""
        missing = (
            f"{self._shard.path}: what labyrinth {self._first + place} of {self._parent.path} "
            "becomes is missing"
            for place in sorted(self._left)
            if not is_left_out(self._config, self._shard.split, self._parents[place])
        )
        return [*self._problems, *missing]


def parents_of(folder: AnyPath, shard: Shard) -> list[Parent]:
    """Return the labyrinths of a shard with their episodes, in order.

    Raises:
        OSError, ArrowException: The file cannot be read.
        ValueError: Its footer is not what the manifest says, or a text in it is no labyrinth.
    """
    found: list[Parent] = []
    with local_copy(folder / shard.path) as local, open_shard(local) as file:
        if wrong := footer_problem(file, shard.rows):
            raise ValueError(wrong)
        table = file.read(["info", "actions", "episode_starts"])
    rows = zip(
        texts(table["info"]),
        table["actions"].to_pylist(),
        table["episode_starts"].to_pylist(),
        strict=True,
    )
    for info, of_labyrinth in groupby(rows, key=lambda row: without_agent(row[0] or "")):
        routes: list[list[int]] = []
        for _, action, starts in of_labyrinth:
            if starts or not routes:
                routes.append([])
            routes[-1].append(action)
        found.append(Parent(parse(info), [route[:-1] for route in routes]))
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

"""The check of one shard, in which every row is replayed.

The labyrinth is parsed from `info`, states and rewards follow from replaying `actions`, pictures
from the renderer. The file must hold the same, byte for byte if the libraries are those of the
manifest. `rules` says which labyrinths and routes there have to be.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from itertools import chain, groupby
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.data.columns import Row, arrow_schema
from labyrinth_core.data.dataset_config import DatasetConfig
from labyrinth_core.data.errors import DatasetError, one_line
from labyrinth_core.data.manifest import Shard
from labyrinth_core.data.rows import footer_problem, open_shard, read_schema, tables_of, texts
from labyrinth_core.data.splits import SPLITS
from labyrinth_core.data.storage import AnyPath, file_sha256, local_copy
from labyrinth_core.language.text import without_agent
from labyrinth_core.world.labyrinth import Labyrinth, LabyrinthError
from labyrinth_core.world.solver import moves_and_routes
from pipeline.generation.check_rows import EpisodeRows, Problem, check_labyrinth, episodes_of
from pipeline.generation.check_table import table_problems
from pipeline.generation.fingerprint import Fingerprint
from pipeline.generation.rules import Route, labyrinth_problems, routes_problem
from pipeline.generation.shifts import Train
from pipeline.generation.tabulate import Facts, FactsOfShard
from pipeline.generation.variants import labyrinth_of
from pipeline.inspection.routes import routes_of


@dataclass(frozen=True)
class CheckJob:
    """All that a worker needs to check one shard."""

    folder: AnyPath
    shard: Shard
    config: DatasetConfig
    first: int
    """The number of its first labyrinth in the split, or of that one's parent in the parent's."""
    first_row: int
    """The number of rows of the split in earlier shards."""
    same_bytes: bool
    """Whether pictures must be equal byte for byte, since the libraries are the manifest's."""
    train: Train
    """What train has."""
    parent: Shard | None = None
    """The shard with the labyrinths that those of this one are made from."""
    table_row: int | None = None
    """The row of its first labyrinth in the table of labyrinths; None not to compare them."""


@dataclass(frozen=True)
class ShardReport:
    """The problems and the structures of one shard."""

    shard: Shard
    problems: list[str]
    structures: NDArray[np.int64] = field(default_factory=lambda: np.empty((0, 2), np.int64))
    """The id of each structure, and the first row it is in: shape (structures, 2). There may be
    millions."""


class Parent(NamedTuple):
    """A labyrinth of the parent with the actions of its episodes."""

    labyrinth: Labyrinth
    episodes: list[list[int]]


class Group(NamedTuple):
    """The rows of one labyrinth, as they are read."""

    number: int
    """The number of the labyrinth in its split, or of its parent in the parent's."""
    text: str
    first_row: int
    episodes: Iterator[EpisodeRows]
    parent: Parent | None
    """None if the split has no parent, if it cannot be read, or has no such labyrinth."""


class CheckedRows(NamedTuple):
    """What the rows of a shard are."""

    problems: list[str]
    structures: dict[str, int]
    """Structure id -> the first row it is in."""
    facts: Facts
    counts: dict[str, Any]
    """What the manifest should say of them, by name."""


def check_shard(job: CheckJob) -> ShardReport:
    """Return what is wrong with one shard, and where its structures are."""
    import pyarrow as pa

    path = job.shard.path
    try:
        with local_copy(job.folder / path) as local:
            if not read_schema(local).equals(arrow_schema(), check_metadata=False):
                return ShardReport(job.shard, [f"{path}: its columns are not the five"])
            with open_shard(local) as file:
                if problem := footer_problem(file, job.shard.rows):
                    return ShardReport(job.shard, [f"{path}: {problem}"])
                problems, structures, facts, counts = _check_rows(job, file)
            counts |= {"bytes": local.stat().st_size, "sha256": file_sha256(local)}
    except FileNotFoundError:
        return ShardReport(job.shard, [f"{path} is missing"])
    except MemoryError:  # Of Arrow, too; nothing is wrong with the file.
        raise
    except (OSError, pa.ArrowException, UnicodeDecodeError) as error:
        return ShardReport(job.shard, [f"{path} cannot be read: {one_line(error)}"])
    for name, value in counts.items():
        if value != (expected := getattr(job.shard, name)):
            problems.append(f"{path}: {name} {value}, but the manifest says {expected}")
    # What the table should say of a shard with problems is not known.
    if job.table_row is not None and not problems:
        split, rows = job.shard.split, (job.table_row, job.first_row)
        problems += table_problems(job.folder, job.config, split, facts, *rows)
    pairs = [(int(each, 16), row) for each, row in structures.items()]
    return ShardReport(job.shard, problems, np.array(pairs, np.int64).reshape(-1, 2))


def _check_rows(job: CheckJob, file: Any) -> CheckedRows:
    """Return what the rows of a shard are, compared with those of its parent."""
    config, split = job.config, job.shard.split
    fingerprint, facts = Fingerprint(), FactsOfShard(split)
    problems: list[Problem] = []
    structures: dict[str, int] = {}
    lengths: list[int] = []
    labyrinths = cut = 0
    parents, unreadable = _parents(job)
    for group in _grouped(job, _rows(file, problems), parents):
        found = check_labyrinth(
            config, split, group.number, group.text, group.episodes, same_bytes=job.same_bytes
        )
        fingerprint.update(found.rows)
        problems += found.problems
        lengths += found.lengths
        labyrinths += 1
        if found.labyrinth is None:
            continue
        if parents is not None and group.parent is None:
            message = f"labyrinth {group.number} has no parent"
            problems.append(Problem(group.first_row, "obs", message))
        problems += _broken_rules(job, group, found.labyrinth, found.routes)
        before = structures.setdefault(found.labyrinth.structure.structure_id, group.first_row)
        if before != group.first_row and not SPLITS[split].new_structure:
            message = f"the structure is also in row {before}"
            problems.append(Problem(group.first_row, "info", message))
        if found.routes:
            _add_facts(facts, group, found.labyrinth, found.routes)
            cut += config.is_cut(split, len(found.routes))
    counts = {
        "rows": sum(lengths),
        "longest": max(lengths, default=1) - 1,
        "cut": cut,
        "episodes": len(lengths),
        "labyrinths": labyrinths,
        "fingerprint": fingerprint.hexdigest(),
    }
    lines = [f"{job.shard.path} row {row} {column}: {what}" for row, column, what in problems]
    lines += [*unreadable, *_left_out(job, parents or {})]
    return CheckedRows(lines, structures, facts.array(), counts)


def _grouped(
    job: CheckJob, rows: Iterable[Row], parents: dict[int, Parent] | None
) -> Iterator[Group]:
    """Yield the rows of each labyrinth; its parent is taken out of `parents`."""
    number = job.first - 1
    for text, group in groupby(episodes_of(rows), lambda each: without_agent(each.rows[0].info)):
        first = next(group)
        number += 1
        if parents is not None:  # Shifts leave labyrinths out; the pictures' names say which.
            number = _number_in(first.rows[0].obs_path, job.shard.split, least=number)
        parent = None if parents is None else parents.pop(number, None)
        yield Group(number, text, first.begin, chain([first], group), parent)  # noqa: B031


def _add_facts(
    facts: FactsOfShard, group: Group, labyrinth: Labyrinth, routes: list[Route]
) -> None:
    actions = [list(chain.from_iterable(route)) for route in routes]
    shortest, episodes = moves_and_routes(labyrinth), sum(map(len, routes))
    parent = None if group.parent is None else group.parent.labyrinth
    facts.add(labyrinth, group.text, shortest, actions, episodes, parent)


def _rows(file: Any, problems: list[Problem]) -> Iterator[Row]:
    """Yield the rows of a file up to the first that has a null, which is added to the problems."""
    first = 0
    for table in tables_of(file):
        values = ("obs", "actions", "rewards", "episode_starts")
        columns = [*(table[name].to_pylist() for name in values), texts(table["info"])]
        del table  # It holds the pictures a second time.
        rows = zip(*columns, strict=True)
        for number, (obs, action, paid, starts, info) in enumerate(rows, start=first):
            picture = obs or {"bytes": None, "path": None}
            row = Row(picture["bytes"], picture["path"], action, paid, starts, info, b"")
            missing = [name for name, value in row._asdict().items() if value is None]
            if missing:
                column = missing[0].removesuffix("_path")
                problems.append(Problem(number, column, "nothing there"))
                return
            yield row
        first += len(columns[0])


def _parents(job: CheckJob) -> tuple[dict[int, Parent] | None, list[str]]:
    """Return the parents of the labyrinths of a shard by number, and why they cannot be read.

    They are None if the split has no parent, or if they cannot be read.
    """
    if job.parent is None:
        return None, []
    found: list[Parent] = []
    try:
        for route in routes_of(job.folder, job.parent):
            if route.is_first:
                found.append(Parent(route.labyrinth, []))
            found[-1].episodes.append([*route.actions])
    except DatasetError as error:
        reason = f"cannot be compared with {job.parent.path}, which cannot be read"
        return None, [f"{job.shard.path} {reason}: {one_line(error)}"]
    return dict(enumerate(found, start=job.first)), []


def _number_in(path: str, split: str, *, least: int) -> int:
    """Return the number of a labyrinth in the name of a picture; the least possible if none is."""
    named = re.match(rf"{split}-(\d{{6,9}})-", path, re.ASCII)
    return max(least, int(named[1])) if named else least


def _broken_rules(
    job: CheckJob, group: Group, labyrinth: Labyrinth, routes: list[Route]
) -> Iterator[Problem]:
    """Yield the rules that a labyrinth and its routes break."""
    config, split, row, parent = job.config, job.shard.split, group.first_row, group.parent
    origin = None if parent is None else parent.labyrinth
    for message in labyrinth_problems(config, split, labyrinth, origin, job.train):
        yield Problem(row, "info", message)
    if not routes:
        return  # Its rows have been found wrong.
    episodes = [*chain.from_iterable(routes)]
    if parent is not None and SPLITS[split].is_redrawn and episodes != parent.episodes:
        yield Problem(row, "actions", "the routes are not its parent's")
    if wrong := routes_problem(config, split, labyrinth, routes):
        yield Problem(row, "actions", wrong)


def _left_out(job: CheckJob, parents: dict[int, Parent]) -> Iterator[str]:
    """Yield the parents from which a labyrinth should have been made, and was not."""
    for number, parent in parents.items():
        try:
            labyrinth_of(job.config, job.shard.split, parent.labyrinth.structure)
        except LabyrinthError:
            continue  # There is no such variant.
        origin = f"labyrinth {number} of {SPLITS[job.shard.split].parent}"
        yield f"{job.shard.path}: what {origin} becomes is missing"

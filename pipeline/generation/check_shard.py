"""The check of one shard, in which every row is replayed.

The labyrinth is parsed from `info`, states and rewards follow from replaying `actions`, pictures
from the renderer. The file must hold the same, byte for byte if the libraries are those of the
manifest. `rules` says which labyrinths and routes there have to be.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from itertools import chain, groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.data.dataset_config import DatasetConfig
from labyrinth_core.data.errors import DatasetError, one_line
from labyrinth_core.data.manifest import Shard
from labyrinth_core.data.rows import footer_problem, open_shard, read_schema, tables_of
from labyrinth_core.data.splits import SPLITS
from labyrinth_core.data.storage import AnyPath, file_sha256, local_copy
from labyrinth_core.world.labyrinth import Labyrinth, LabyrinthError
from labyrinth_core.world.solver import moves_and_routes
from pipeline.generation.check_rows import EpisodeRows, Problem, check_labyrinth, episodes_of
from pipeline.generation.check_table import table_problems
from pipeline.generation.fingerprint import Fingerprint, Row
from pipeline.generation.rules import labyrinth_problems, routes_problem
from pipeline.generation.shifts import Train
from pipeline.generation.tabulate import FactsOfShard
from pipeline.generation.variants import labyrinth_of
from pipeline.generation.write import arrow_schema
from pipeline.inspection.routes import routes_of

if TYPE_CHECKING:
    import pyarrow as pa


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
    """The id of the structure of each labyrinth, and its first row: shape (labyrinths, 2). There
    may be millions."""


class Parent(NamedTuple):
    """A labyrinth of the parent with the actions of its episodes."""

    labyrinth: Labyrinth
    episodes: list[list[int]]


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
                return _check_rows(job, file, local)
    except FileNotFoundError:
        return ShardReport(job.shard, [f"{path} is missing"])
    except MemoryError:  # Of Arrow, too; nothing is wrong with the file.
        raise
    except (OSError, pa.ArrowException, UnicodeDecodeError) as error:
        return ShardReport(job.shard, [f"{path} cannot be read: {one_line(error)}"])


def _check_rows(job: CheckJob, file: Any, local: Path) -> ShardReport:
    """Return what is wrong with the rows of a file, and what its manifest says otherwise."""
    config, split = job.config, job.shard.split
    fingerprint, facts = Fingerprint(), FactsOfShard(split)
    problems: list[Problem] = []
    structures: list[tuple[int, int]] = []
    lengths: list[int] = []
    rows = labyrinths = cut = 0
    parents, unreadable = _parents(job)
    for number, text, episodes in _labyrinths(job, _rows(file, problems), parents is not None):
        found = check_labyrinth(config, split, number, text, episodes, same_bytes=job.same_bytes)
        parent = None if parents is None else parents.pop(number, None)
        first_row, rows, labyrinths = rows, rows + sum(found.lengths), labyrinths + 1
        fingerprint.update(found.rows)
        problems += found.problems
        lengths += found.lengths
        if found.labyrinth is None:
            continue
        structures.append((int(found.labyrinth.structure.structure_id, 16), first_row))
        if parents is not None and parent is None:
            problems.append(Problem(first_row, "obs", f"labyrinth {number} has no parent"))
        broken = _broken_rules(job, found.labyrinth, found.routes, parent)
        problems += (Problem(first_row, *each) for each in broken)
        if found.routes:
            _add_facts(facts, text, found.labyrinth, found.routes, parent)
            cut += config.is_cut(split, len(found.routes))
    counts: dict[str, int | str] = {"rows": rows, "longest": max(lengths, default=1) - 1}
    counts |= {"cut": cut, "episodes": len(lengths), "labyrinths": labyrinths}
    counts |= {"fingerprint": fingerprint.hexdigest()}
    counts |= {"bytes": local.stat().st_size, "sha256": file_sha256(local)}
    lines = [f"{job.shard.path} row {row} {column}: {what}" for row, column, what in problems]
    lines += [*unreadable, *_left_out(job, parents or {}), *_otherwise(job.shard, counts)]
    # What the table should say of a shard with problems is not known.
    if job.table_row is not None and not lines:
        table = job.table_row, job.first_row
        lines += table_problems(job.folder, config, split, facts.array(), *table)
    return ShardReport(job.shard, lines, np.array(structures, np.int64).reshape(-1, 2))


def _add_facts(
    facts: FactsOfShard,
    text: str,
    labyrinth: Labyrinth,
    routes: list[list[int]],
    parent: Parent | None,
) -> None:
    origin = None if parent is None else parent.labyrinth
    facts.add(labyrinth, text, moves_and_routes(labyrinth), routes, origin)


def _otherwise(shard: Shard, counts: Mapping[str, int | str]) -> Iterator[str]:
    """Yield what the manifest says of a shard that is not so."""
    for name, value in counts.items():
        if value != (expected := getattr(shard, name)):
            yield f"{shard.path}: {name} {value}, but the manifest says {expected}"


def _labyrinths(
    job: CheckJob, rows: Iterable[Row], has_parents: bool
) -> Iterator[tuple[int, str, Iterator[EpisodeRows]]]:
    """Yield the number of each labyrinth, or of its parent in the parent's; text and episodes."""
    number = job.first - 1
    for text, group in groupby(episodes_of(rows), lambda each: each.rows[0].info):
        first = next(group)
        number += 1
        if has_parents:  # Shifts leave labyrinths out; the pictures' names say which.
            number = _number_in(first.rows[0].obs_path, job.shard.split, least=number)
        yield number, text, chain([first], group)  # noqa: B031


def _rows(file: Any, problems: list[Problem]) -> Iterator[Row]:
    """Yield the rows of a file up to the first that has a null, which is added to the problems."""
    first = 0
    for table in tables_of(file):
        values = ("obs", "actions", "rewards", "episode_starts")
        columns = [*(table[name].to_pylist() for name in values), _texts(table["info"])]
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
    """Return the number of a labyrinth in the name of a picture, or `least` if it is less."""
    named = re.match(rf"{split}-(\d{{6,9}})-", path, re.ASCII)
    return max(least, int(named[1])) if named else least


def _broken_rules(
    job: CheckJob, labyrinth: Labyrinth, routes: list[list[int]], parent: Parent | None
) -> Iterator[tuple[str, str]]:
    """Yield the rules that a labyrinth and its routes break, each with the column that shows it."""
    config, split = job.config, job.shard.split
    origin = None if parent is None else parent.labyrinth
    for message in labyrinth_problems(config, split, labyrinth, origin, job.train):
        yield "info", message
    if not routes:
        return  # Its rows have been found wrong.
    if parent is not None and SPLITS[split].is_redrawn and routes != parent.episodes:
        yield "actions", "the routes are not its parent's"
    if wrong := routes_problem(config, split, labyrinth, routes):
        yield "actions", wrong


def _left_out(job: CheckJob, parents: dict[int, Parent]) -> Iterator[str]:
    """Yield the parents from which a labyrinth should have been made, and was not."""
    for number, parent in parents.items():
        try:
            labyrinth_of(job.config, job.shard.split, parent.labyrinth.structure)
        except LabyrinthError:
            continue  # There is no such variant.
        origin = f"labyrinth {number} of {SPLITS[job.shard.split].parent}"
        yield f"{job.shard.path}: what {origin} becomes is missing"


def _texts(column: pa.ChunkedArray) -> list[str | None]:
    """Return the texts of a column, equal ones as one object if it is dictionary-encoded.

    The text of a labyrinth of 250x250 has half a megabyte, and hundreds of rows share it.
    """
    import pyarrow as pa

    if not pa.types.is_dictionary(column.type):
        return column.to_pylist()  # type: ignore[no-any-return]
    found: list[str | None] = []
    for chunk in column.chunks:
        values = [*chunk.dictionary.to_pylist(), None]
        found += [values[-1 if place is None else place] for place in chunk.indices.to_pylist()]
    return found

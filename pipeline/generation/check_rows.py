"""Compare the rows of a shard with those that the build would write, labyrinth by labyrinth.

Each labyrinth and its routes must also keep the rules of its split, whatever program made them.
"""

from __future__ import annotations

import io
import re
import warnings
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain, groupby, pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.data import COLUMNS, SPLITS, DatasetConfig, Shard, ShardFile
from labyrinth_core.errors import DatasetError, one_line
from labyrinth_core.language import LabyrinthSyntaxError, dump, parse
from labyrinth_core.pictures import PICTURE_SIZE, PictureDigest
from labyrinth_core.world import Labyrinth, LabyrinthError, Solver, Structure
from pipeline.generation.labyrinths import NEW_STRUCTURES, Solution, labyrinth_and_parent
from pipeline.generation.shard import Row
from pipeline.generation.shifts import SELECTED_SHIFTS, Measures, Train


@dataclass(frozen=True)
class CheckJob:
    """All that a worker needs to check one shard."""

    file: ShardFile
    config: DatasetConfig
    first: int
    """The number in its split of the first labyrinth in the shard, or in `parent` if given."""
    first_row: int
    """The number of rows of the split in earlier shards."""
    same_bytes: bool
    """Whether pictures must be equal byte for byte, because the manifest's libraries are used."""
    train: Train
    """The properties of train."""
    parent: ShardFile | None = None
    """The shard with the parents of this shard's labyrinths, if they have parents."""
    table_row: int | None = None
    """The row of its first labyrinth in the table of labyrinths; None skips the comparison."""

    @property
    def shard(self) -> Shard:
        """The shard, as the manifest describes it."""
        return self.file.shard


class Problem(NamedTuple):
    """A problem with a field of a row."""

    row: int
    column: str
    message: str


class Found(NamedTuple):
    """The rows of one labyrinth in a file."""

    first: int
    """The number of the first row."""
    info: str
    """The text in the first row."""
    picture: str
    """The name of the first picture."""
    rows: Iterator[Row]


class Remade(NamedTuple):
    """A labyrinth that was made again."""

    number: int
    """Its number in the split, or its parent's number in the parent split."""
    parent: Labyrinth | None
    info: str
    """Its text."""
    solution: Solution


def rows_of(file: Any, problems: list[Problem]) -> Iterator[Row]:
    """Yield the rows of a file up to the first with a null, which is added to `problems`."""
    first, names = 0, [column.name for column in COLUMNS.numbers]
    for batch in COLUMNS.values_in(file):
        columns = [batch.pop(name) for name in ("obs.bytes", "obs.path", *names, "info")]
        rows = zip(*columns, strict=True)
        for number, (picture, path, *numbers, info) in enumerate(rows, start=first):
            if None in (values := (picture, path, *numbers, info)):
                column = ("obs", "obs", *names, "info")[values.index(None)]
                problems.append(Problem(number, column, "no value"))
                return
            yield Row(picture, path, tuple(numbers), info, b"")
        first += len(columns[0])


def labyrinths_of(rows: Iterable[Row]) -> Iterator[Found]:
    """Yield the rows of each labyrinth, to be read before the next labyrinth is asked for.

    A new labyrinth begins where the text changes. But a single row with another text that does not
    begin an episode counts as a wrong row of the same labyrinth.
    """

    def numbered() -> Iterator[tuple[int, int, Row]]:
        labyrinth, text = -1, None
        for number, (row, following) in enumerate(pairwise(chain(rows, [None]))):
            assert row is not None
            if row.info != text:
                is_next = following is not None and following.info == row.info
                if text is None or row.starts or is_next:
                    labyrinth, text = labyrinth + 1, row.info
            yield labyrinth, number, row

    for _, group in groupby(numbered(), lambda each: each[0]):
        _, first, row = next(group)
        rest = (each for *_, each in group)  # noqa: B031
        yield Found(first, row.info, row.obs_path, chain([row], rest))


def made_again(
    job: CheckJob, labyrinths: Iterator[Found], problems: list[Problem]
) -> Iterator[tuple[Found, Remade]]:
    """Yield the rows of each labyrinth, and the labyrinth that the build makes of its structure.

    Texts without a labyrinth, missing labyrinths and labyrinths without their parent are added to
    `problems`.

    Raises:
        DatasetError: The shard of the parent cannot be read.
    """
    if job.parent is not None:
        yield from _of_parent(job, job.parent, labyrinths, problems)
        return
    for number, found in enumerate(labyrinths, start=job.first):
        try:
            right = _remade(job, number, parse(found.info).structure)
        except LabyrinthSyntaxError as error:
            problems.append(Problem(found.first, "info", _no_labyrinth(error)))
        except LabyrinthError as error:
            problems.append(Problem(found.first, "info", one_line(error)))
        else:
            yield found, right


def _of_parent(
    job: CheckJob, parent: ShardFile, labyrinths: Iterator[Found], problems: list[Problem]
) -> Iterator[tuple[Found, Remade]]:
    """Do the work of `made_again` with the structures in the parent's shard.

    A labyrinth is missing if the name of the next picture has a higher number.
    """
    pattern = re.compile(rf"{job.shard.split}-(\d{{6,9}})-", re.ASCII)
    found, before = next(labyrinths, None), ""
    for number, structure in enumerate(_structures_of(parent), start=job.first):
        try:
            right = _remade(job, number, structure)
        except LabyrinthError:
            continue  # The parent has no such variant.
        if right.info == before:  # As in `numbered_labyrinths`.
            continue
        before = right.info
        named = pattern.match(found.picture) if found else None
        if found is None or (named and int(named[1]) > number):
            row = found.first if found else job.shard.rows
            what = f"the labyrinth made from labyrinth {number} of {parent.shard.split} is missing"
            problems.append(Problem(row, "info", what))
        else:
            yield found, right
            found = next(labyrinths, None)
    others = chain([found] if found else [], labyrinths)
    without = f"a labyrinth that is not made from any of {parent.shard.split}"
    problems += (Problem(other.first, "info", without) for other in others)


def _structures_of(file: ShardFile) -> Iterator[Structure]:
    """Yield the structure of each labyrinth of a shard; raise DatasetError if it is damaged."""
    blocks = file.rows(pictures=False)
    infos = (rows.texts[n] for rows in blocks for n in rows.info[rows.episode_starts].tolist())
    for info, _ in groupby(infos):
        try:
            yield parse(info).structure
        except LabyrinthError as error:
            reason = f"{file.path} cannot be read: {one_line(error)}"
            raise DatasetError(reason) from error


def _remade(job: CheckJob, number: int, structure: Structure) -> Remade:
    """Return the labyrinth that the build makes of a structure.

    Raises:
        LabyrinthError: The build makes no labyrinth of the structure.
    """
    config, split = job.config, job.shard.split
    if (structure.height, structure.width) != (config.height, config.width):
        raise LabyrinthError(f"a labyrinth of {structure.height}x{structure.width}")
    labyrinth, parent = labyrinth_and_parent(config, split, structure)
    return Remade(number, parent, dump(labyrinth), Solution.of(config, split, labyrinth))


def differences(
    job: CheckJob, found: Found, right: Remade, rows: Iterator[Row]
) -> Iterator[Problem]:
    """Yield the differences between the rows of a labyrinth and those that were made again.

    The labyrinth that was made again must keep the rules, and the one in the file, too, if it
    differs.

    Args:
        job: The job.
        found: The rows in the file.
        right: The labyrinth that was made again.
        rows: The rows of `right`.
    """
    config, split, solution = job.config, job.shard.split, right.solution
    rules = partial(labyrinth_problems, config, split, parent=right.parent, train=job.train)
    broken = [*rules(solution.labyrinth), *route_problems(config, split, solution)]
    if found.info != right.info:
        broken += _described(config, found.info, solution.labyrinth, rules)
    yield from (Problem(found.first, "info", message) for message in dict.fromkeys(broken))
    if found.info != right.info:
        return
    problems, count = list[Problem](), 0
    for count, row in enumerate(found.rows, start=1):
        its = next(rows, row)
        if row[:-1] != its[:-1]:  # All but the digest of the picture.
            wrong = _differing(row, its, same_bytes=job.same_bytes)
            problems += (Problem(found.first + count - 1, *each) for each in wrong)
    expected = sum(len(episode.states) for episode in solution.episodes)
    if count != expected:
        yield Problem(found.first, "actions", f"{count} rows, not {expected}")
        # The first wrong row explains those after it.
        problems = [problem for problem in problems if problem.row == problems[0].row]
    yield from problems


def _described(
    config: DatasetConfig,
    text: str,
    right: Labyrinth,
    rules: Callable[[Labyrinth], Iterable[str]],
) -> Iterator[str]:
    """Yield why a text is not the text of `right`, the labyrinth that was made again."""
    try:
        found = parse(text)
    except LabyrinthSyntaxError as error:
        yield _no_labyrinth(error)
        return
    if found == right:
        yield "not in the canonical form"
    elif (found.size_name, found.task) != (right.size_name, config.task):
        yield f"a labyrinth of {found.size_name}, {found.task}"
    else:
        yield "not the labyrinth that its structure gives with this seed"
        yield from rules(found)


def _no_labyrinth(error: LabyrinthSyntaxError) -> str:
    return f"not a labyrinth: {str(error).splitlines()[0]}"


def _differing(found: Row, right: Row, *, same_bytes: bool) -> Iterator[tuple[str, str]]:
    """Yield the columns in which a row differs from the one that was made again, and how."""
    if found.info != right.info:
        yield "info", "not the labyrinth that the episode began with"
    names = "obs", *(column.name for column in COLUMNS.numbers)
    values, others = ((row.obs_path, *row.numbers) for row in (found, right))
    for name, value, other in zip(names, values, others, strict=True):
        if value != other:
            yield name, f"{value!r:.99}, not {other!r}"
    if found.obs != right.obs:
        try:
            picture = _decoded(found.obs)
        except ValueError as error:
            yield "obs", str(error)
            return
        if PictureDigest.of(picture) != right.picture_digest:
            yield "obs", "not the picture of the state that the actions lead to"
        elif same_bytes:
            yield "obs", "the right pixels, but not the encoder's bytes"


def _decoded(png: bytes) -> NDArray[np.uint8]:
    """Return the pixels of a picture; raise ValueError if its format is not ours."""
    from PIL import Image

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # Pillow may only warn of a decompression bomb.
            with Image.open(io.BytesIO(png), formats=["PNG"]) as image:
                if image.size != (PICTURE_SIZE, PICTURE_SIZE) or image.mode != "RGB":
                    raise ValueError(f"it is {image.size}, {image.mode}")
                return np.array(image)
    except Exception as error:  # Pillow's parser raises many kinds.
        raise ValueError(
            f"not a picture of {PICTURE_SIZE} pixels, RGB: {one_line(error)}"
        ) from error


def labyrinth_problems(
    config: DatasetConfig,
    split: str,
    labyrinth: Labyrinth,
    parent: Labyrinth | None,
    train: Train,
) -> Iterator[str]:
    """Yield a message for each rule of a split that a labyrinth breaks.

    Args:
        config: The configuration of the dataset.
        split: The split of the labyrinth.
        labyrinth: The labyrinth.
        parent: The labyrinth that it is made from; None if it has no parent, or an unknown one.
        train: The properties of train.
    """
    kind, structure = SPLITS[split], labyrinth.structure
    if not structure.is_connected:
        yield "not every cell can be reached"
    solver = Solver(labyrinth)
    if not solver.tiles_matter:
        yield "the tiles of the task make no difference"
    bucket = config.bucket_of(structure)
    if bucket != kind.bucket:
        yield f"the structure belongs to {bucket or 'no split'}"
    if labyrinth.look is not kind.look:
        yield f"its look is {labyrinth.look}, not {kind.look}"
    if parent is not None:
        yield from _relation_problems(config, split, labyrinth, parent)
    if split in SELECTED_SHIFTS:
        measures = Measures(solver.moves, structure.loops, structure.junctions)
        problem = SELECTED_SHIFTS[split].problem(measures, lambda: labyrinth, train)
        if problem is not None:
            yield problem


def _relation_problems(
    config: DatasetConfig, split: str, labyrinth: Labyrinth, parent: Labyrinth
) -> Iterator[str]:
    """Yield each difference between a labyrinth and its parent that the split does not allow."""
    kind = SPLITS[split]
    if kind.new_structure:
        if problem := NEW_STRUCTURES[split].problem(config, parent, labyrinth):
            yield problem
        return
    if labyrinth.structure != parent.structure:
        yield f"its structure is not that of its parent in {kind.parent}"
        return
    moved = labyrinth.start != parent.start, labyrinth.goal != parent.goal
    if moved != (kind.new_start, kind.new_goal):
        yield "start and goal are not changed as the split says"
    elif not any(moved):
        if replace(labyrinth, look=parent.look) != parent:
            yield f"more than its look differs from its parent in {kind.parent}"
    elif labyrinth.structure.grid_distance(labyrinth.start, labyrinth.goal) < (
        least := _least_apart(config, split, parent)
    ):
        yield f"start and goal are less than {least} moves apart"


def _least_apart(config: DatasetConfig, split: str, parent: Labyrinth) -> int:
    """Return the least distance between a changed start and goal, in moves without walls."""
    kind, least = SPLITS[split], (config.height + config.width) // 2
    if kind.new_start and kind.new_goal:
        return least
    # If only one of the two moves, no cell may be that far from the other.
    stays = parent.goal if kind.new_start else parent.start
    cells = {*range(parent.structure.cells)} - {parent.start, parent.goal}
    return min(least, max(parent.structure.grid_distance(cell, stays) for cell in cells))


def route_problems(config: DatasetConfig, split: str, solution: Solution) -> Iterator[str]:
    """Yield a message for each rule that the demonstrations of a labyrinth break.

    Each route must end at the goal, and be as short as possible unless `solutions` is `all`. These
    rules do not apply to a random policy or a demonstrator with noise.
    """
    if split == "random" or config.noise:
        return
    labyrinth, best = solution.labyrinth, Solver(solution.labyrinth).moves
    if any(episode.states[-1].agent != labyrinth.goal for episode in solution.episodes):
        yield "an episode ends before the goal"
    lengths = {len(episode) for episode in solution.episodes}
    if config.solutions != "all" and lengths != {best}:
        yield f"routes of {', '.join(map(str, sorted(lengths)))} moves, instead of {best}"

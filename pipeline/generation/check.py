"""The check of one shard: every row replayed.

The labyrinth comes from `info`, states and rewards from replaying `actions`, the picture from the
renderer; what the file holds must be the same, bytes included where the libraries are the
manifest's. Routes must be those the configuration asks for, and structures in the split that
their hash allows.
"""

from __future__ import annotations

import io
import warnings
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import numpy as np

from labyrinth_core.data.columns import NO_ACTION, Row, arrow_schema, open_shard, read_schema, texts
from labyrinth_core.data.dataset_config import DatasetConfig
from labyrinth_core.data.errors import one_line
from labyrinth_core.data.fingerprint import Fingerprint, decoded_picture_digest
from labyrinth_core.data.manifest import Shard
from labyrinth_core.data.storage import AnyPath, file_sha256, local_copy
from labyrinth_core.language.text import LabyrinthSyntaxError, dump, parse
from labyrinth_core.pictures.png import PICTURE_SIZE
from labyrinth_core.pictures.renderer import render
from labyrinth_core.world.dynamics import State, initial, is_terminal, reward, transition
from labyrinth_core.world.grid import Action
from labyrinth_core.world.labyrinth import Labyrinth
from pipeline.generation.render import Picture, Pictures, picture_names
from pipeline.generation.rules import labyrinth_problems, route_problem


@dataclass
class ShardReport:
    """What checking one shard brought to light."""

    shard: Shard
    problems: list[str] = field(default_factory=list)
    structures: dict[str, int] = field(default_factory=dict)
    """Structure id -> the first row it is in."""

    def problem(self, row: int, column: str, message: str) -> None:
        """Note a problem with a field of a row."""
        self.problems.append(f"{self.shard.path} row {row} {column}: {message}")


@dataclass(frozen=True)
class CheckJob:
    """All that a worker needs to know to check one shard."""

    folder: AnyPath
    shard: Shard
    config: DatasetConfig
    first: int
    """Place of its first labyrinth in the split."""
    same_bytes: bool
    """Whether the pictures must be the very bytes, the libraries being the manifest's."""


def check_shard(job: CheckJob) -> ShardReport:
    """Return what is wrong with one shard."""
    import pyarrow as pa

    report = ShardReport(job.shard)
    path = job.folder / job.shard.path
    try:
        with local_copy(path) as local:
            digest, size = file_sha256(local), local.stat().st_size
            if not read_schema(local).equals(arrow_schema(), check_metadata=False):
                report.problems.append(f"{job.shard.path}: its columns are not the five")
                return report
            with open_shard(local) as file:
                _ShardCheck(job, report).check(_rows(file, report))
    except FileNotFoundError:
        report.problems.append(f"{job.shard.path} is missing")
        return report
    except (OSError, pa.ArrowException, UnicodeDecodeError) as error:
        report.problems.append(f"{job.shard.path} cannot be read: {one_line(error)}")
        return report
    if size != job.shard.bytes:
        report.problems.append(
            f"{job.shard.path}: {size} bytes, but the manifest says {job.shard.bytes}"
        )
    if digest != job.shard.sha256:
        report.problems.append(f"{job.shard.path}: its sha256 is {digest}, not the manifest's")
    return report


def _rows(file: Any, report: ShardReport) -> Iterator[Row]:
    """Yield the rows of a file, up to the first with a field that holds nothing."""
    first = 0
    for group in range(file.num_row_groups):
        table = file.read_row_group(group)
        values = ("obs", "actions", "rewards", "episode_starts")
        columns = [*(table[name].to_pylist() for name in values), texts(table["info"])]
        del table  # The pictures are in it once more.
        rows = zip(*columns, strict=True)
        for number, (obs, action, paid, starts, info) in enumerate(rows, start=first):
            row = Row(*_picture(obs), action, paid, starts, info, b"")
            missing = [name for name, value in row._asdict().items() if value is None]
            if missing:
                report.problem(number, missing[0].removesuffix("_path"), "nothing there")
                return
            yield row
        first += len(columns[0])


def _picture(obs: dict[str, Any] | None) -> tuple[Any, Any]:
    return (None, None) if obs is None else (obs["bytes"], obs["path"])


class _ShardCheck:
    """Goes through the rows of a shard and notes in a report what is wrong."""

    def __init__(self, job: CheckJob, report: ShardReport) -> None:
        self.job = job
        self.report = report
        self.fingerprint = Fingerprint()
        self.row = 0
        self.labyrinths = self.episodes = self.longest = self.cut = 0
        self.routes: list[list[int]] = []
        self.ended = True
        """Whether the episode before was not cut, or was one of another labyrinth."""
        self.labyrinth: Labyrinth | None = None
        self.info: str | None = None
        self.first_row = 0

    def check(self, rows: Iterator[Row]) -> None:
        episode: list[Row] = []
        for row in rows:
            if row.episode_starts and episode:
                self.check_episode(episode)
                episode = []
            episode.append(row)
        if episode:
            self.check_episode(episode, last=True)
        self.finish_labyrinth()
        found = {
            "rows": self.row,
            "longest": self.longest,
            "cut": self.cut,
            "episodes": self.episodes,
            "labyrinths": self.labyrinths,
            "fingerprint": self.fingerprint.hexdigest(),
        }
        for name, value in found.items():
            expected = getattr(self.job.shard, name)
            if value != expected:
                message = f"{self.job.shard.path}: {name} {value}, but the manifest says {expected}"
                self.report.problems.append(message)

    def check_episode(self, rows: list[Row], *, last: bool = False) -> None:
        """Check the rows from one `episode_starts` to the next."""
        begin = self.row
        self.row += len(rows)
        self.episodes += 1
        self.longest = max(self.longest, len(rows) - 1)
        if not rows[0].episode_starts:
            self.report.problem(begin, "episode_starts", "False in the first row of the file")
        if rows[0].info != self.info:
            self.begin_labyrinth(rows[0].info, begin)
        for offset, row in enumerate(rows):
            if row.info != self.info:
                message = "not the labyrinth that the episode began with"
                self.report.problem(begin + offset, "info", message)
        if self.labyrinth is None:
            return
        for offset, row in enumerate(rows[:-1]):
            if row.actions == NO_ACTION:
                message = "False, but the row before ends an episode"
                self.report.problem(begin + offset + 1, "episode_starts", message)
                return
        if rows[-1].actions != NO_ACTION and last:
            self.report.problem(self.row - 1, "actions", "the file ends before the episode does")
            return
        if rows[-1].actions != NO_ACTION:
            message = "True, but the episode before has not ended"
            self.report.problem(begin + len(rows), "episode_starts", message)
            return
        self.replay(self.labyrinth, rows, begin)

    def replay(self, labyrinth: Labyrinth, rows: list[Row], begin: int) -> None:
        """Check states, rewards and pictures by taking the actions."""
        pictures = _pictures(labyrinth)
        state = initial(labyrinth)
        place = len(self.routes)
        if not self.ended:
            message = "an episode is cut before the last one of its labyrinth"
            self.report.problem(begin - 1, "actions", message)
        split, number_of_it = self.job.shard.split, self.job.first + self.labyrinths - 1
        names = picture_names(split, number_of_it, place, range(len(rows)))
        for step, (row, name) in enumerate(zip(rows, names, strict=True)):
            number = begin + step
            if row.obs_path != name:
                message = f"its path is {row.obs_path!r:.99}, not {name}"
                self.report.problem(number, "obs", message)
            self.check_picture(pictures[state], labyrinth, state, row, number)
            if row.actions == NO_ACTION:
                if row.rewards != 0:
                    self.report.problem(number, "rewards", f"{row.rewards} after the last action")
                break
            if not 0 <= row.actions < len(Action):
                self.report.problem(number, "actions", f"{row.actions} is no action")
                return
            if is_terminal(labyrinth, state):
                self.report.problem(number, "actions", "the episode had ended before")
                return
            after = transition(labyrinth, state, row.actions)
            meant = self.meant(pictures, labyrinth, state, after, rows[step + 1 :])
            if meant is not None:
                message = f"{row.actions}, but the next picture shows what {meant} leads to"
                self.report.problem(number, "actions", message)
                after = transition(labyrinth, state, meant)
            expected = np.float32(reward(labyrinth, after))
            if np.float32(row.rewards) != expected:
                message = f"{row.rewards}, but the step pays {expected}"
                self.report.problem(number, "rewards", message)
            state = after
        last = begin + len(rows) - 1
        if self.job.shard.split != "random" and state.agent != labyrinth.goal:
            self.report.problem(last, "actions", "the episode ends before the goal")
        self.ended = is_terminal(labyrinth, state)
        self.routes.append([row.actions for row in rows[:-1]])

    def check_picture(
        self, expected: Picture, labyrinth: Labyrinth, state: State, row: Row, number: int
    ) -> None:
        """Check a picture, and add the row to the fingerprint."""
        digest = expected.digest
        if row.obs != expected.png:
            try:
                picture = _decode(row.obs)
            except ValueError as error:
                self.report.problem(number, "obs", str(error))
                return
            if not np.array_equal(picture, render(labyrinth, state)):
                self.report.problem(number, "obs", "not the picture of the state")
                digest = decoded_picture_digest(picture)
            elif self.job.same_bytes:
                self.report.problem(number, "obs", "the right pixels, but not the encoder's bytes")
        self.fingerprint.update([row._replace(picture_digest=digest)])

    @staticmethod
    def meant(
        pictures: Pictures,
        labyrinth: Labyrinth,
        state: State,
        after: State,
        rows: list[Row],
    ) -> int | None:
        """Return the action that leads to the next picture, if it is not the one taken."""
        row, *later = rows
        if row.obs == pictures[after].png:
            return None
        if later and 0 <= row.actions < len(Action):
            following = transition(labyrinth, after, row.actions)
            if later[0].obs == pictures[following].png:
                return None  # The action was right: it is this one picture that is not.
        for action in Action:
            other = transition(labyrinth, state, action)
            if other != after and row.obs == pictures[other].png:
                return int(action)
        return None

    def begin_labyrinth(self, info: str, row: int) -> None:
        """Check what does not depend on the episodes, and the episodes of the one before."""
        self.finish_labyrinth()
        self.info, self.labyrinth, self.first_row = info, None, row
        self.labyrinths += 1
        try:
            labyrinth = parse(info)
        except LabyrinthSyntaxError as error:
            message = str(error).splitlines()[0]
            self.report.problem(row, "info", f"not a labyrinth: {message}")
            return
        config = self.job.config
        if (labyrinth.size_name, labyrinth.task) != (
            f"{config.height}x{config.width}",
            config.task,
        ):
            message = f"a labyrinth of {labyrinth.size_name}, {labyrinth.task}"
            self.report.problem(row, "info", message)
            return
        self.labyrinth = labyrinth
        for message in labyrinth_problems(config, self.job.shard.split, labyrinth):
            self.report.problem(row, "info", message)
        if dump(labyrinth) != info:
            self.report.problem(row, "info", "not in the canonical form")
        structure_id = labyrinth.structure.structure_id
        if structure_id in self.report.structures:
            other = self.report.structures[structure_id]
            self.report.problem(row, "info", f"the structure is also in row {other}")
        self.report.structures.setdefault(structure_id, row)

    def finish_labyrinth(self) -> None:
        """Check that the labyrinth has the episodes that the configuration asks for."""
        routes, self.routes, self.ended = self.routes, [], True
        if self.labyrinth is None or not routes:
            return
        config, split = self.job.config, self.job.shard.split
        if config.solutions != "shortest" and split != "random":
            self.cut += len(routes) == config.solutions_limit
        message = route_problem(config, split, self.labyrinth, routes)
        if message:
            self.report.problem(self.first_row, "actions", message)


@lru_cache(maxsize=1)
def _pictures(labyrinth: Labyrinth) -> Pictures:
    """Return the pictures of a labyrinth; consecutive episodes are of the same."""
    return Pictures(labyrinth)


def _decode(png: bytes) -> np.ndarray[Any, np.dtype[np.uint8]]:
    """Return the pixels of a picture; raises ValueError if it is none of ours."""
    from PIL import Image

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # Of a picture that is a bomb Pillow may only warn.
            with Image.open(io.BytesIO(png), formats=["PNG"]) as image:
                if image.size != (PICTURE_SIZE, PICTURE_SIZE) or image.mode != "RGB":
                    raise ValueError(f"it is {image.size}, {image.mode}")
                return np.array(image)
    except Exception as error:  # Pillow raises whatever its parser stumbles over.
        raise ValueError(
            f"not a picture of {PICTURE_SIZE} pixels, RGB: {one_line(error)}"
        ) from error

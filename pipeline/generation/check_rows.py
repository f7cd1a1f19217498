"""The check of the rows of one shard: labyrinths, episodes replayed, pictures, routes."""

from __future__ import annotations

import io
import warnings
from collections.abc import Iterator, Mapping
from itertools import chain
from typing import TYPE_CHECKING, Any

import numpy as np

from labyrinth_core.data.columns import NO_ACTION, Row
from labyrinth_core.data.errors import one_line
from labyrinth_core.data.fingerprint import Fingerprint, decoded_picture_digest
from labyrinth_core.data.splits import SPLITS, is_selected
from labyrinth_core.language.text import (
    LabyrinthSyntaxError,
    agent_text,
    dump,
    parse,
    without_agent,
)
from labyrinth_core.pictures.png import PICTURE_SIZE
from labyrinth_core.pictures.renderer import render
from labyrinth_core.world.dynamics import State, initial, is_terminal, reward, transition
from labyrinth_core.world.grid import Action
from labyrinth_core.world.labyrinth import Labyrinth
from labyrinth_core.world.solver import moves_and_routes, moves_of
from pipeline.generation.extremes import memory_problem, shift_problem
from pipeline.generation.relations import Relations
from pipeline.generation.render import Picture, Pictures, picture_names
from pipeline.generation.rules import labyrinth_problems, pieces_problem, route_problem
from pipeline.generation.tabulate import FactsOfShard
from pipeline.machinery.worker import count

if TYPE_CHECKING:
    from pipeline.generation.check import CheckJob, ShardReport


class ShardCheck:
    """The check of the rows of a shard, which notes problems in a report."""

    def __init__(self, job: CheckJob, report: ShardReport) -> None:
        self.job = job
        self.report, self.problem = report, report.problem
        self.fingerprint = Fingerprint()
        self.facts = FactsOfShard(job.shard.split)
        self.row = 0
        self.labyrinths = self.episodes = self.longest = self.cut = 0
        self.in_pieces = job.config.is_in_pieces(job.shard.split)
        self.routes: list[list[list[int]]] = []
        """The actions of each piece of each route of the labyrinth; a whole route is one piece."""
        self.cut_in: State | None = None
        """The state in which the previous episode of the labyrinth was cut; None if it was not."""
        self.labyrinth: Labyrinth | None = None
        self.pictures: Mapping[State, Picture] = {}
        self.text: str | None = None
        """The text of the labyrinth, wherever its episodes begin."""
        self.first_row = 0
        self.number = job.first - 1
        """The number of the labyrinth in its split, or of its parent in the parent's."""
        self.numbers: list[int] = []
        """Those of all labyrinths, ascending."""
        self.relations: Relations | None = None
        if job.parent is not None:
            self.relations = Relations(job.folder, job.config, job.shard, job.parent, job.first)

    def check(self, rows: Iterator[Row]) -> dict[str, Any]:
        """Check rows, and return what the manifest should say of them."""
        episode: list[Row] = []
        for row in rows:
            if row.episode_starts and episode:
                self.check_episode(episode)
                episode = []
            episode.append(row)
        if episode:
            self.check_episode(episode, last=True)
        self.finish_labyrinth()
        if self.relations is not None:
            self.report.problems += self.relations.problems()
        return {
            "rows": self.row,
            "longest": self.longest,
            "cut": self.cut,
            "episodes": self.episodes,
            "labyrinths": self.labyrinths,
            "fingerprint": self.fingerprint.hexdigest(),
        }

    def check_episode(self, rows: list[Row], *, last: bool = False) -> None:
        """Check the rows from one `episode_starts` to the next."""
        begin = self.row
        self.row += len(rows)
        count(len(rows))
        self.episodes += 1
        self.longest = max(self.longest, len(rows) - 1)
        if not rows[0].episode_starts:
            self.problem(begin, "episode_starts", "False in the first row of the file")
        if without_agent(rows[0].info) != self.text:
            self.begin_labyrinth(rows[0], begin)
        for number, row in enumerate(rows, start=begin):
            if row.info != rows[0].info:
                self.problem(number, "info", "not the labyrinth that the episode began with")
        if self.labyrinth is None:
            return
        ends = [row.actions == NO_ACTION for row in rows]
        after = begin + ends.index(True) + 1 if True in ends else self.row
        if after < self.row:
            self.problem(after, "episode_starts", "False, but the row before ends an episode")
        elif ends[-1]:
            self.replay(self.labyrinth, rows, begin)
        elif last:
            self.problem(self.row - 1, "actions", "the file ends before the episode does")
        else:
            self.problem(self.row, "episode_starts", "True, but the episode before has not ended")

    def replay(self, labyrinth: Labyrinth, rows: list[Row], begin: int) -> None:
        """Replay the actions, and compare names, pictures and rewards in each state."""
        state = self.first_state(labyrinth, rows[0].info, begin)
        split, place = self.job.shard.split, sum(map(len, self.routes))
        names = picture_names(split, self.number, place, range(len(rows)))
        for number, (row, name) in enumerate(zip(rows, names, strict=True), start=begin):
            if row.obs_path != name:
                self.problem(number, "obs", f"its path is {row.obs_path!r:.99}, not {name}")
            self.check_picture(labyrinth, state, row, number)
            if row.actions == NO_ACTION:
                if row.rewards != 0:
                    self.problem(number, "rewards", f"{row.rewards} after the last action")
                break
            if not 0 <= row.actions < len(Action):
                self.problem(number, "actions", f"{row.actions} is no action")
                return
            if is_terminal(labyrinth, state):
                self.problem(number, "actions", "the episode had ended before")
                return
            after = transition(labyrinth, state, row.actions)
            meant = self.meant(labyrinth, state, after, rows[number - begin + 1 :][:2])
            if meant is not None:
                message = f"{row.actions}, but the next picture shows what {meant} leads to"
                self.problem(number, "actions", message)
                after = transition(labyrinth, state, meant)
            expected = np.float32(reward(labyrinth, after))
            if np.float32(row.rewards) != expected:
                self.problem(number, "rewards", f"{row.rewards}, but the step pays {expected}")
            state = after
        may_fail = split == "random" or self.job.config.noise > 0 or self.in_pieces
        if not may_fail and state.agent != labyrinth.goal:
            self.problem(self.row - 1, "actions", "the episode ends before the goal")
        if self.cut_in is None or not self.in_pieces:
            self.routes.append([])
        self.cut_in = None if is_terminal(labyrinth, state) else state
        self.routes[-1].append([row.actions for row in rows[:-1]])

    def first_state(self, labyrinth: Labyrinth, info: str, row: int) -> State:
        """Return the state in which the text of an episode says that it begins, and check it."""
        expected = initial(labyrinth)
        if self.cut_in is not None and self.in_pieces:
            expected = self.cut_in
        elif self.cut_in is not None:
            message = "an episode is cut before the last one of its labyrinth"
            self.problem(row - 1, "actions", message)
        try:
            found = labyrinth if info == self.text else parse(info)
        except LabyrinthSyntaxError as error:
            self.problem(row, "info", f"not a labyrinth: {str(error).splitlines()[0]}")
            return expected
        state = initial(found)
        if found is not labyrinth and dump(found) != info:
            self.problem(row, "info", "not in the canonical form")
        elif state != expected:
            begins, should = (agent_text(labyrinth, each) for each in (state, expected))
            self.problem(row, "info", f"the agent begins in {begins}, not in {should}")
        return state

    def check_picture(self, labyrinth: Labyrinth, state: State, row: Row, number: int) -> None:
        """Check a picture, and add the row to the fingerprint."""
        png, digest = self.pictures[state]
        if row.obs != png:
            try:
                picture = _decode(row.obs)
            except ValueError as error:
                self.problem(number, "obs", str(error))
                return
            if not np.array_equal(picture, render(labyrinth, state)):
                self.problem(number, "obs", "not the picture of the state")
                digest = decoded_picture_digest(picture)
            elif self.job.same_bytes:
                self.problem(number, "obs", "the right pixels, but not the encoder's bytes")
        self.fingerprint.update([row._replace(picture_digest=digest)])

    def meant(
        self, labyrinth: Labyrinth, state: State, after: State, rows: list[Row]
    ) -> int | None:
        """Return the action from `state` to the next picture, if it is not the one to `after`.

        `rows` are the next row, and the one after it if there is one.
        """
        row, *later = rows
        if row.obs == self.pictures[after].png:
            return None
        if later and 0 <= row.actions < len(Action):
            following = transition(labyrinth, after, row.actions)
            if later[0].obs == self.pictures[following].png:
                return None  # The action was right: it is this one picture that is not.
        for action in Action:
            other = transition(labyrinth, state, action)
            if other != after and row.obs == self.pictures[other].png:
                return int(action)
        return None

    def begin_labyrinth(self, first_row: Row, row: int) -> None:
        """Finish the previous labyrinth, and check all of the next one but its episodes."""
        self.finish_labyrinth()
        info, split = without_agent(first_row.info), self.job.shard.split
        self.text, self.first_row = info, row
        self.labyrinth = None
        self.labyrinths += 1
        self.number += 1
        if self.relations is not None:
            self.number = self.relations.numbered(first_row.obs_path, least=self.number)
        try:
            labyrinth = parse(info).from_start()
        except LabyrinthSyntaxError as error:
            self.problem(row, "info", f"not a labyrinth: {str(error).splitlines()[0]}")
            return
        config = self.job.config
        size = f"{config.height}x{config.width}"
        if (labyrinth.size_name, labyrinth.task) != (size, config.task):
            self.problem(row, "info", f"a labyrinth of {labyrinth.size_name}, {labyrinth.task}")
            return
        self.labyrinth, self.pictures = labyrinth, Pictures(labyrinth)
        for message in labyrinth_problems(config, split, labyrinth):
            self.problem(row, "info", message)
        if is_selected(split):
            moves, loops = moves_of(labyrinth), labyrinth.structure.loops
            no = shift_problem(split, moves, loops, self.job.extremes)
            if no is None and split == "test_new_routes":
                no = memory_problem(labyrinth, moves, self.job.extremes)
            if no is not None:
                self.problem(row, "info", no)
        if self.relations is not None:
            for column, message in self.relations.of(self.number, labyrinth):
                self.problem(row, column, message)
        if dump(labyrinth) != info:
            self.problem(row, "info", "not in the canonical form")
        first = self.report.structures.setdefault(labyrinth.structure.structure_id, row)
        if first != row and not SPLITS[split].new_structure:
            self.problem(row, "info", f"the structure is also in row {first}")

    def finish_labyrinth(self) -> None:
        """Check that the labyrinth has the episodes that the configuration asks for."""
        pieces, self.routes = self.routes, []
        cut_in, self.cut_in = self.cut_in, None
        if self.labyrinth is None or not pieces:
            return
        routes = [list(chain.from_iterable(route)) for route in pieces]
        episodes = list(chain.from_iterable(pieces))
        config, split = self.job.config, self.job.shard.split
        if config.solutions != "shortest" and split != "random":
            self.cut += len(routes) == config.solutions_limit
        if self.text is not None:
            shortest = moves_and_routes(self.labyrinth)
            self.facts.add(self.labyrinth, self.text, shortest, routes, len(episodes))
            self.numbers.append(self.number)
        if self.relations is not None and not self.relations.allows(self.number, episodes):
            self.problem(self.first_row, "actions", "the routes are not its parent's")
        message = route_problem(config, split, self.labyrinth, routes)
        if self.in_pieces:
            message = message or pieces_problem(config.pieces, pieces)
            if cut_in is not None and not config.noise:
                message = message or "the pieces of a route end before the goal"
        if message:
            self.problem(self.first_row, "actions", message)


def _decode(png: bytes) -> np.ndarray[Any, np.dtype[np.uint8]]:
    """Return the pixels of a picture; raise ValueError if its format is not ours."""
    from PIL import Image

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # Pillow may only warn of a decompression bomb.
            with Image.open(io.BytesIO(png), formats=["PNG"]) as image:
                if image.size != (PICTURE_SIZE, PICTURE_SIZE) or image.mode != "RGB":
                    raise ValueError(f"it is {image.size}, {image.mode}")
                return np.array(image)
    except Exception as error:  # Pillow raises whatever its parser stumbles over.
        raise ValueError(
            f"not a picture of {PICTURE_SIZE} pixels, RGB: {one_line(error)}"
        ) from error

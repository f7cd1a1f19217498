"""The check of the rows of one labyrinth: its episodes are replayed, and their pictures drawn."""

from __future__ import annotations

import io
import warnings
from collections.abc import Iterable, Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.data.columns import NO_ACTION
from labyrinth_core.data.dataset_config import DatasetConfig
from labyrinth_core.data.errors import one_line
from labyrinth_core.language.text import LabyrinthSyntaxError, dump, parse
from labyrinth_core.pictures.png import PICTURE_SIZE, strips_in
from labyrinth_core.pictures.renderer import render
from labyrinth_core.world.dynamics import State, initial, is_terminal, reward, transition
from labyrinth_core.world.grid import Action
from labyrinth_core.world.labyrinth import Labyrinth
from pipeline.generation.fingerprint import PictureDigest, Row
from pipeline.generation.render import Pictures, picture_names


class Problem(NamedTuple):
    """A problem with a field of a row."""

    row: int
    column: str
    message: str


class EpisodeRows(NamedTuple):
    """The rows from one `episode_starts` to the next."""

    begin: int
    """The number of the first row."""
    rows: list[Row]
    is_last: bool
    """Whether the file ends with them."""

    @property
    def actions(self) -> list[int]:
        """The actions of all rows."""
        return [row.actions for row in self.rows]

    @property
    def is_whole(self) -> bool:
        """Whether the last row has no action, and all others have one."""
        return self.rows[-1].actions == NO_ACTION and NO_ACTION not in self.actions[:-1]


class CheckedLabyrinth(NamedTuple):
    """What the rows of one labyrinth are."""

    problems: list[Problem]
    lengths: list[int]
    """The number of rows of each episode."""
    labyrinth: Labyrinth | None
    """None if the text is not a labyrinth of the dataset."""
    routes: list[list[int]]
    """The actions of the episodes that could be replayed."""
    rows: list[Row]
    """The rows of these episodes, without pictures, but with the digests of those."""


def episodes_of(rows: Iterable[Row]) -> Iterator[EpisodeRows]:
    """Yield rows from one `episode_starts` to the next."""
    begin, episode = 0, list[Row]()
    for number, row in enumerate(rows):
        if row.episode_starts and episode:
            yield EpisodeRows(begin, episode, is_last=False)
            begin, episode = number, []
        episode.append(row)
    if episode:
        yield EpisodeRows(begin, episode, is_last=True)


def check_labyrinth(
    config: DatasetConfig,
    split: str,
    number: int,
    text: str,
    episodes: Iterable[EpisodeRows],
    *,
    same_bytes: bool,
) -> CheckedLabyrinth:
    """Return what the rows of a labyrinth are.

    Args:
        config: The configuration of the dataset.
        split: The split of the labyrinth.
        number: The number of the labyrinth, which is part of the names of its pictures.
        text: Its text.
        episodes: Its episodes, at least one.
        same_bytes: Whether pictures must be equal byte for byte.
    """
    problems: list[Problem] = []
    lengths: list[int] = []
    routes: list[list[int]] = []
    checked: list[Row] = []
    labyrinth, wrong = _parsed(config, text)
    pictures = None if labyrinth is None else Pictures(labyrinth)
    end: State | None = None
    for episode in episodes:
        begin, rows, _ = episode
        if wrong and not lengths:
            problems.append(Problem(begin, "info", wrong))
        lengths.append(len(rows))
        problems += _shape_problems(episode)
        if labyrinth is None or pictures is None or not episode.is_whole:
            continue
        if end is not None and not is_terminal(labyrinth, end):
            message = "an episode is cut before the last one of its labyrinth"
            problems.append(Problem(begin - 1, "actions", message))
        names = picture_names(split, number, len(routes), range(len(rows)))
        found, shown, after = _replay(labyrinth, pictures, episode, names, same_bytes=same_bytes)
        problems += found
        checked += shown
        if after is None:
            continue
        routes.append(episode.actions[:-1])
        end = after
    may_fail = split == "random" or config.noise > 0
    if labyrinth is not None and end is not None and end.agent != labyrinth.goal and not may_fail:
        last = begin + len(rows) - 1
        problems.append(Problem(last, "actions", "the episode ends before the goal"))
    return CheckedLabyrinth(problems, lengths, labyrinth, routes, checked)


def _parsed(config: DatasetConfig, text: str) -> tuple[Labyrinth | None, str | None]:
    """Return the labyrinth of a text, None if the dataset cannot have it, and what is wrong."""
    try:
        labyrinth = parse(text)
    except LabyrinthSyntaxError as error:
        return None, f"not a labyrinth: {str(error).splitlines()[0]}"
    if (labyrinth.size_name, labyrinth.task) != (f"{config.height}x{config.width}", config.task):
        return None, f"a labyrinth of {labyrinth.size_name}, {labyrinth.task}"
    return labyrinth, None if dump(labyrinth) == text else "not in the canonical form"


def _shape_problems(episode: EpisodeRows) -> Iterator[Problem]:
    """Yield where `episode_starts`, `info` and the last action do not make one whole episode."""
    begin, rows, is_last = episode
    if not rows[0].episode_starts:
        yield Problem(begin, "episode_starts", "False in the first row of the file")
    for number, row in enumerate(rows, start=begin):
        if row.info != rows[0].info:
            yield Problem(number, "info", "not the labyrinth that the episode began with")
    if NO_ACTION in episode.actions[:-1]:
        after = begin + episode.actions.index(NO_ACTION) + 1
        yield Problem(after, "episode_starts", "False, but the row before ends an episode")
    elif rows[-1].actions != NO_ACTION and is_last:
        yield Problem(begin + len(rows) - 1, "actions", "the file ends before the episode does")
    elif rows[-1].actions != NO_ACTION:
        message = "True, but the episode before has not ended"
        yield Problem(begin + len(rows), "episode_starts", message)


def _replay(
    labyrinth: Labyrinth,
    pictures: Pictures,
    episode: EpisodeRows,
    names: list[str],
    *,
    same_bytes: bool,
) -> tuple[list[Problem], list[Row], State | None]:
    """Replay the actions of an episode; compare names, pictures and rewards in each state.

    Returns:
        The problems, the rows that were replayed as in `CheckedLabyrinth`, and the last state, None
        if an action is impossible.
    """
    problems: list[Problem] = []
    checked: list[Row] = []
    state = initial(labyrinth)
    for number, (row, name) in enumerate(zip(episode.rows, names, strict=True), episode.begin):
        if row.obs_path != name:
            message = f"its path is {row.obs_path!r:.99}, not {name}"
            problems.append(Problem(number, "obs", message))
        digest = pictures[state].digest
        if row.obs != pictures[state].png:
            wrong, digest = _other_picture(row.obs, labyrinth, state, digest)
            if wrong is None and same_bytes:
                wrong = "the right pixels, but not the encoder's bytes"
            problems += [Problem(number, "obs", wrong)] if wrong else []
        checked.append(row._replace(obs=b"", picture_digest=digest))
        if row.actions == NO_ACTION:
            if row.rewards != 0:
                problems.append(Problem(number, "rewards", f"{row.rewards} after the last action"))
            break
        if not 0 <= row.actions < len(Action) or is_terminal(labyrinth, state):
            known = 0 <= row.actions < len(Action)
            message = "the episode had ended before" if known else f"{row.actions} is no action"
            problems.append(Problem(number, "actions", message))
            return problems, checked, None
        state = transition(labyrinth, state, row.actions)
        expected = np.float32(reward(labyrinth, state))
        if np.float32(row.rewards) != expected:
            message = f"{row.rewards}, but the step pays {expected}"
            problems.append(Problem(number, "rewards", message))
    return problems, checked, state


def _other_picture(
    png: bytes, labyrinth: Labyrinth, state: State, digest: bytes
) -> tuple[str | None, bytes]:
    """Return why a picture in other bytes does not show a state, and the digest of its pixels."""
    try:
        pixels = _decoded(png)
    except ValueError as error:
        return str(error), digest
    if np.array_equal(pixels, render(labyrinth, state)):
        return None, digest
    digest = PictureDigest(strips_in(pixels)).digest({})
    return "not the picture of the state that the actions lead to", digest


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
    except Exception as error:  # Pillow raises whatever its parser stumbles over.
        raise ValueError(
            f"not a picture of {PICTURE_SIZE} pixels, RGB: {one_line(error)}"
        ) from error

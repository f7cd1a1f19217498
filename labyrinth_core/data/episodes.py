"""Replay episodes: find the labyrinth and the state of each row, as arrays.

Labyrinths of one kind are parsed and replayed together. All loaders build on these arrays: they
make pictures, vectors and texts, and the arrays of `evaluation`, from them.
"""

from __future__ import annotations

from collections.abc import Generator, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from math import fsum
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.data.dataset_config import DatasetConfig
from labyrinth_core.data.format import NO_ACTION
from labyrinth_core.data.rows import Rows, joined
from labyrinth_core.errors import DatasetError, one_line
from labyrinth_core.language import dump, labyrinth_id, parse, parse_many
from labyrinth_core.pictures import ObservationSpec, PictureError
from labyrinth_core.world import Labyrinth, Labyrinths, Solver

PARSED_CELLS = 2**16
"""The cells of labyrinths that are parsed and replayed in one batch."""


class WholeEpisodes(NamedTuple):
    """The rows of e whole episodes, e >= 1."""

    rows: Rows
    firsts: NDArray[np.int64]
    """The first row of each episode, shape (e,)."""
    lasts: NDArray[np.int64]
    """The last row of each, which takes no action, shape (e,)."""

    def each(self) -> Iterator[tuple[str, list[int], float]]:
        """Yield the text, the actions and the return of each episode."""
        for first, last in zip(self.firsts.tolist(), self.lasts.tolist(), strict=True):
            text = self.rows.texts[self.rows.info[first]]
            rewards = self.rows.rewards[first:last].tolist()
            yield text, self.rows.actions[first:last].tolist(), fsum(rewards)

    def take(self, episodes: slice | NDArray[np.bool_]) -> WholeEpisodes:
        """Return some of the episodes."""
        chosen = np.zeros(len(self.firsts), np.bool_)
        chosen[episodes] = True
        lengths = self.lasts - self.firsts + 1
        rows = self.rows.take(np.repeat(chosen, lengths))
        ends = np.cumsum(lengths[chosen])
        return WholeEpisodes(rows, ends - lengths[chosen], ends - 1)


def grouped(blocks: Iterable[Rows]) -> Iterator[WholeEpisodes]:
    """Group blocks of rows into episodes, which may span several blocks.

    Raises:
        DatasetError: The rows do not form episodes; raised after the episodes before that row.
    """
    pending: Rows | None = None
    before = 0
    for block in blocks:
        rows = block if pending is None else joined([pending, block])
        ends = np.flatnonzero(rows.actions == NO_ACTION)
        problem = _problem(rows, ends, before)
        if problem is not None:
            ends = ends[ends < problem[0]]
        whole = int(ends[-1]) + 1 if len(ends) else 0
        if whole:
            yield WholeEpisodes(rows.take(slice(whole)), np.append(0, ends[:-1] + 1), ends)
        if problem is not None:
            raise DatasetError(problem[1])
        before += whole
        pending = rows.take(slice(whole, None)) if whole < len(rows.actions) else None
    if pending is not None:
        raise DatasetError("the last episode ends without its last row, actions=-1")


def _problem(rows: Rows, ends: NDArray[np.int64], before: int) -> tuple[int, str] | None:
    """Return the first row that breaks an episode, and why; None if all rows form episodes.

    Args:
        rows: The rows; the first must begin an episode.
        ends: The indices of the rows without an action.
        before: The number of rows before these.
    """
    begins = np.zeros(len(rows.actions), np.bool_)
    begins[:1] = True
    begins[ends[ends < len(begins) - 1] + 1] = True
    starts, other = rows.episode_starts, np.diff(rows.info, prepend=rows.info[:1]) != 0
    wrong = np.where(begins, ~starts | (rows.actions == NO_ACTION), starts | other)
    if not wrong.any():
        return None
    row = int(wrong.argmax())
    reason = ": an episode ends without its last row, actions=-1"
    if begins[row]:
        reason = " actions: -1 in the first row of an episode"
        if not starts[row]:
            reason = " episode_starts: False where an episode must begin"
    return row, f"row {before + row}{reason}"


@dataclass(frozen=True, eq=False, repr=False)
class LoadedEpisode:
    """One episode of a dataset."""

    labyrinth_id: int
    info: str
    """The labyrinth in the text language."""
    observations: NDArray[Any]
    """Observations of the T + 1 states: uint8 (T + 1, size, size, 3), int32 (T + 1, length) or
    texts (T + 1,)."""
    actions: NDArray[np.int64]
    """Actions taken, shape (T,)."""
    rewards: NDArray[np.float32]
    """Rewards received, shape (T,)."""
    terminated: bool
    """Whether the episode ends on the goal or on ice, instead of being cut."""
    columns: Mapping[str, NDArray[Any]] = field(default_factory=dict)
    """The dataset's other columns (`format.OTHERS`) by name, in each of the T + 1 states."""

    @property
    def truncated(self) -> bool:
        """Whether the episode was cut: an episode of a dataset is terminated or truncated."""
        return not self.terminated

    @property
    def actions_of_states(self) -> NDArray[np.int64]:
        """The action taken in each of the T + 1 states: -1 in the last, as in the column."""
        return np.append(self.actions, NO_ACTION)

    @property
    def beginning(self) -> tuple[int, int]:
        """The id of the labyrinth, and the index of its first state, see `state_index`."""
        labyrinth = parse(self.info)
        return self.labyrinth_id, labyrinth.state_index(labyrinth.initial)

    def copy(self) -> LoadedEpisode:
        """Return the episode with arrays of its own."""
        return LoadedEpisode(
            self.labyrinth_id,
            self.info,
            self.observations.copy(),
            self.actions.copy(),
            self.rewards.copy(),
            self.terminated,
            {name: values.copy() for name, values in self.columns.items()},
        )

    def __len__(self) -> int:
        """Return the number of transitions."""
        return len(self.actions)

    def __repr__(self) -> str:
        """Return the number of steps, how they end, the labyrinth and what is observed."""
        end, seen = "terminated" if self.terminated else "truncated", self.observations
        steps = f"{len(self)} steps in {self.labyrinth_id:016x}, {end}"
        return f"LoadedEpisode({steps}; observations {seen.shape} {seen.dtype})"


@dataclass(frozen=True, eq=False)
class Episodes:
    """One or more replayed episodes, in labyrinths of one size, task and look."""

    whole: WholeEpisodes
    """The n rows of the episodes."""
    texts: list[str]
    """The canonical text of each labyrinth."""
    labyrinths: Labyrinths
    which: NDArray[np.int64]
    """The index in `labyrinths` of each row's labyrinth, shape (n,)."""
    states: NDArray[np.int64]
    """The index of each row's state, as in `Labyrinth.state_index`, shape (n,)."""
    over: NDArray[np.bool_]
    """Whether each row's state is terminal, on the goal or on ice, shape (n,)."""

    @property
    def ids(self) -> NDArray[np.int64]:
        """The id of each labyrinth; files hold it as the text `f"{id:016x}"`."""
        return np.array([int(labyrinth_id(text), 16) for text in self.texts], np.int64)

    @property
    def acting(self) -> NDArray[np.bool_]:
        """Whether an action is taken in each row: in all but the last of each episode."""
        acting = np.ones(len(self.states), np.bool_)
        acting[self.whole.lasts] = False
        return acting

    def parsed(self) -> list[Labyrinth]:
        """Return the labyrinths, one by one."""
        return [parse(text) for text in self.texts]

    def take(self, episodes: slice) -> Episodes:
        """Return consecutive episodes, with only their own labyrinths."""
        firsts, lasts = self.whole.firsts[episodes], self.whole.lasts[episodes]
        rows = slice(int(firsts[0]), int(lasts[-1]) + 1)
        whole = WholeEpisodes(self.whole.rows.take(rows), firsts - rows.start, lasts - rows.start)
        used, which = np.unique(self.which[rows], return_inverse=True)
        return Episodes(
            whole,
            [self.texts[number] for number in used.tolist()],
            self.labyrinths.take(used),
            which,
            self.states[rows],
            self.over[rows],
        )

    def observed(
        self, spec: ObservationSpec, pictures: NDArray[np.uint8] | None = None
    ) -> NDArray[Any]:
        """Return the observation in each row, shape (n, ...).

        Args:
            spec: How the states are observed.
            pictures: Output array, shape (n, image_size, image_size, 3); None for a new one.

        Raises:
            DatasetError: A picture is missing or cannot be decoded.
        """
        if pictures is None and spec.observation == "image":
            pictures = spec.memory(len(self.states))
        if spec.decodes:
            pngs = self.whole.rows.pngs
            assert pngs is not None
            try:
                return spec.decoded(pngs, pictures)
            except PictureError as error:
                raise DatasetError(f"obs: {one_line(error)}") from error
        if spec.of_arrays:
            return spec.look_together(self.labyrinths, self.which, self.states, pictures)
        parsed = self.parsed()
        seen = zip(self.which.tolist(), self.states.tolist(), strict=True)
        looks = spec.look([(parsed[n], parsed[n].state_at(state)) for n, state in seen])
        if pictures is None:
            return looks
        pictures[:] = looks
        return pictures

    def parts(self, rows: int) -> Generator[Episodes]:
        """Yield consecutive groups of episodes, with about `rows` rows each."""
        number = self.whole.lasts // rows
        begins = np.flatnonzero(np.diff(number, prepend=-1)).tolist()
        for begin, end in zip(begins, [*begins[1:], len(number)], strict=True):
            yield self.take(slice(begin, end))

    def loaded(self, observations: NDArray[Any]) -> Iterator[LoadedEpisode]:
        """Yield the episodes one by one, given each row's observation; all arrays are views."""
        (rows, firsts, lasts), ids = self.whole, self.ids
        for first, last in zip(firsts.tolist(), lasts.tolist(), strict=True):
            yield LoadedEpisode(
                labyrinth_id=int(ids[self.which[first]]),
                info=rows.texts[rows.info[first]],
                observations=observations[first : last + 1],
                actions=rows.actions[first:last],
                rewards=rows.rewards[first:last],
                terminated=bool(self.over[last]),
                columns={name: of[first : last + 1] for name, of in rows.others.items()},
            )

    def optimal(self) -> NDArray[np.bool_]:
        """Return which actions begin a shortest route in each row, shape (n, 4)."""
        tables = np.stack([Solver(labyrinth).optimal_actions() for labyrinth in self.parsed()])
        return tables[self.which, self.states]


def replayed(blocks: Iterable[Rows], config: DatasetConfig | None = None) -> Generator[Episodes]:
    """Replay rows and yield their episodes in order, many at a time.

    Args:
        blocks: The rows.
        config: The dataset, whose size and task every labyrinth must have; None for any.

    Raises:
        DatasetError: The rows do not form episodes, or a labyrinth has another size or task; raised
            after the episodes before that row.
    """
    for whole in grouped(blocks):
        rows = whole.rows
        # The text of a labyrinth has at least eight characters per cell.
        together = max(1, PARSED_CELLS * 8 // (len(rows.texts[0]) + 1))
        number = np.maximum.accumulate(rows.info[whole.firsts]) // together
        begins = np.flatnonzero(np.diff(number, prepend=-1)).tolist()
        for begin, end in zip(begins, [*begins[1:], len(number)], strict=True):
            some = whole.take(slice(begin, end)) if len(begins) > 1 else whole
            yield from _replayed(some, config)


def _replayed(whole: WholeEpisodes, config: DatasetConfig | None) -> Generator[Episodes]:
    """Yield the episodes all together if `_together` can, else one by one."""
    used, which = np.unique(whole.rows.info[whole.firsts], return_inverse=True)
    texts = [whole.rows.texts[number] for number in used.tolist()]
    episodes = _together(whole, texts, which, config)
    if episodes is not None:
        yield episodes
        return
    for number in range(len(whole.firsts)):
        one = whole.take(slice(number, number + 1))
        try:
            labyrinth = parse(one.rows.texts[one.rows.info[0]])
            labyrinth.replay(one.rows.actions[:-1].tolist())
        except ValueError as error:
            reason = str(error).partition("\n")[0]
            raise DatasetError(f"an episode cannot be replayed: {reason}") from error
        single = _together(one, [dump(labyrinth)], np.zeros(1, np.int64), config)
        assert single is not None
        yield single


def _together(
    whole: WholeEpisodes,
    texts: list[str],
    which: NDArray[np.int64],
    config: DatasetConfig | None,
) -> Episodes | None:
    """Replay episodes together, given labyrinth texts and the index of each episode's text.

    Returns:
        None if a text is not canonical, or an action is invalid or follows a terminal state.

    Raises:
        DatasetError: A labyrinth has another size or task than the dataset.
    """
    actions = whole.rows.actions
    labyrinths = parse_many(texts)
    if labyrinths is not None and config is not None:
        of = labyrinths.structures
        kind = of.height, of.width, labyrinths.task
        if kind != (config.height, config.width, config.task):
            raise DatasetError(
                f"info: a labyrinth of {of.height}x{of.width}, {labyrinths.task}, in a dataset of "
                f"{config.height}x{config.width}, {config.task}"
            )
    # Only the last row of an episode has NO_ACTION.
    if labyrinths is None or ((actions < NO_ACTION) | (actions > 3)).any():
        return None
    replayed = labyrinths.replay(which, whole.firsts, actions)
    if replayed is None:
        return None
    of_row = np.repeat(which, whole.lasts - whole.firsts + 1)
    return Episodes(whole, texts, labyrinths, of_row, *replayed)

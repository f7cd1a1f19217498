"""Load datasets from a folder or the Hub, as episodes or transitions (s, a, s').

    from labyrinth_core import load_transitions

    transitions = load_transitions("data/labyrinth", "5x5", split="train", image_size=64)
    s, a, s_next = transitions[0]

Rows are replayed to find the labyrinth and the state of each, as arrays; labyrinths of one kind are
parsed and replayed together. All loaders build on these arrays: they make pictures, vectors and
texts, and the arrays of `evaluation`, from them. No transition crosses the end of an episode.
Files, local or from the Hub, are parsed, never executed.
"""

from __future__ import annotations

import warnings
from collections.abc import Generator, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.data.dataset import Filter, Part, Query, Source
from labyrinth_core.data.dataset_config import DatasetConfig
from labyrinth_core.data.format import NO_ACTION
from labyrinth_core.data.rows import Rows, WholeEpisodes, grouped
from labyrinth_core.data.transitions import (
    Columns,
    Transitions,
    cached,
    joined_columns,
    name_of,
    user_folder,
)
from labyrinth_core.errors import DatasetError, one_line
from labyrinth_core.language import dump, labyrinth_id, parse, parse_many
from labyrinth_core.pictures import DEFAULT_IMAGE_SIZE, ObservationSpec, PictureError
from labyrinth_core.world import Labyrinth, Labyrinths, Solver

PARSED_CELLS = 2**16
"""The cells of labyrinths that are parsed and replayed in one batch."""


def load_transitions(  # noqa: D417
    source: str | Path,
    config: str,
    *,
    split: str = "train",
    observation: str = "image",
    image_size: int = DEFAULT_IMAGE_SIZE,
    draw: bool = False,
    resize: str = "area",
    revision: str | None = None,
    labyrinths: int | None = None,
    where: Filter | None = None,
    cache_dir: str | Path | bool | None = True,
    optimal: bool = False,
) -> Transitions:
    """Return all transitions of a split.

    Pictures are made once and kept in a cache, which is then memory-mapped. Its name depends on
    the hashes of the shards in the manifest, so a dataset that is built anew gets a new cache. The
    shards are checked against the manifest when the cache is made, and are not read afterwards.

    Args:
        source: Folder with the dataset, or its id on the Hub; see `load_episodes` for this and
            for all arguments that are not explained here.
        config: Name of the dataset's config, such as `5x5`.
        cache_dir: Folder of caches. True means `labyrinth-datasets` in `$XDG_CACHE_HOME` or
            `~/.cache`. False or None holds everything in memory; so does, with a warning, a folder
            that cannot be written, or a full disk. All caches in a folder take at most 20 GB, or
            the number of GB in the environment variable LABYRINTH_CACHE_GB; the least recently
            used are removed.
        optimal: Whether to compute the optimal actions as well, by solving each labyrinth.

    Raises:
        ValueError: An argument has a value that is not allowed.
        DatasetError: As for `load_episodes`, or the split has no episode, or the cache would
            exceed its limit.
    """
    query = Query(Source(source, config, revision), split).filter(where, labyrinths=labyrinths)
    spec = ObservationSpec(observation, image_size, draw, resize)
    return transitions_in(query, spec, cache_dir, optimal=optimal)


def transitions_in(
    query: Query,
    spec: ObservationSpec,
    cache_dir: str | Path | bool | None = True,
    *,
    optimal: bool = False,
) -> Transitions:
    """Return all transitions that a query requests; see `load_transitions`."""
    named = isinstance(cache_dir, str) and cache_dir.strip()
    if not (named or cache_dir is None or isinstance(cache_dir, bool | Path)):
        raise ValueError(f"cache_dir={cache_dir!r}: give a folder, True or False")
    part = query.part()
    transitions = None
    if spec.observation == "image" and cache_dir is not None and cache_dir is not False:
        transitions = _cached(cache_dir, query.split, part, spec)
    if transitions is None:
        transitions = _in_memory(part, spec)
    if not optimal:
        return transitions
    blocks = replayed(part.rows(pictures=False), part.config)
    acting = [block.optimal()[block.acting] for block in blocks]
    return replace(transitions, optimal=np.concatenate(acting))


def _cached(
    cache_dir: str | Path | Literal[True], split: str, part: Part, spec: ObservationSpec
) -> Transitions | None:
    """Return the transitions from a cache; None, with a warning, if the cache cannot be used."""
    try:
        folder = user_folder() if cache_dir is True else Path(cache_dir).expanduser()
        size = int(spec.image_size)
        name = name_of(part.config.name, split, size, (part.key(), *spec.key))
        shape = len(part), size, size, 3
        return Transitions.of(cached(folder / name, shape, _observed(part, spec)))
    except OSError as error:
        reason = f"{error}; so the pictures are held in memory, as with cache_dir=False"
        warnings.warn(f"the frame cache cannot be used: {reason}", stacklevel=4)
        return None


def _in_memory(part: Part, spec: ObservationSpec) -> Transitions:
    part.require_sizes()
    # Making pictures part by part and concatenating them would take twice as long.
    pictures = _frames(len(part), spec.image_size) if spec.observation == "image" else None
    frames, columns = zip(*_observed(part, spec, pictures), strict=True)
    shown = np.concatenate(frames) if pictures is None else pictures
    return Transitions.of({"frames": shown, **joined_columns(columns)})


def _frames(count: int, size: int) -> NDArray[np.uint8]:
    """Return memory for pictures; raise DatasetError if there is not enough."""
    try:
        return np.empty((count, size, size, 3), np.uint8)
    except (MemoryError, ValueError) as error:  # ValueError: more than an address can hold.
        raise DatasetError(
            f"{count:,} pictures of {size} x {size} pixels take {3 * count * size**2 / 1e9:,.1f} "
            "GB, more than there is memory: give a smaller image_size, cache_dir=, or labyrinths="
        ) from error


def _observed(
    part: Part, spec: ObservationSpec, pictures: NDArray[np.uint8] | None = None
) -> Iterator[tuple[NDArray[Any], Columns]]:
    """Yield observations of all states (in `pictures`, if given) and the transitions' columns.

    Raises:
        DatasetError: There is no episode, or a picture cannot be decoded.
    """
    first = 0
    for episodes in together(part.rows(pictures=spec.decodes), spec, part.config):
        end = first + len(episodes.states)
        own = None if pictures is None else pictures[first:end]
        steps, rows = np.flatnonzero(episodes.acting), episodes.whole.rows
        columns: Columns = {
            "rows": first + steps,
            "actions": rows.actions[steps],
            "rewards": rows.rewards[steps],
            "terminated": episodes.over[steps + 1],
            "labyrinth_ids": episodes.ids[episodes.which[steps]],
            **{name: values[steps] for name, values in rows.others.items()},
        }
        yield episodes.observed(spec, own), columns
        first = end
    if not first:
        raise DatasetError("the split has no episodes")


def together(
    rows: Iterable[Rows], spec: ObservationSpec, config: DatasetConfig | None
) -> Iterator[Episodes]:
    """Yield the episodes of rows, in blocks that are observed together; see `replayed`."""
    for block in replayed(rows, config):
        yield from block.parts(spec.together)


def load_episodes(
    source: str | Path,
    config: str,
    *,
    split: str = "train",
    observation: str = "image",
    image_size: int = DEFAULT_IMAGE_SIZE,
    draw: bool = False,
    resize: str = "area",
    revision: str | None = None,
    labyrinths: int | None = None,
    where: Filter | None = None,
) -> Generator[LoadedEpisode]:
    """Yield the episodes of a split, in order.

    Args:
        source: Folder with the dataset, or its id on the Hub such as `user/labyrinth`.
        config: Name of the dataset's config, such as `5x5` or `5x5-key_and_door`.
        split: One of train, validation, test, random, s0, s0_and_g, or a shift.
        observation: "image" for the pictures in `obs`; "vector" for the authors' vectors, made from
            `info` and `actions` alone (see `labyrinth_core.pictures.vector`); "text" for the
            labyrinth in the text language, with the agent in it as `@`.
        image_size: Pixels on each side of the pictures.
        revision: Branch, tag or commit on the Hub; not for folders.
        draw: Whether pictures are drawn from `info` and `actions` instead of decoded from `obs`;
            both are equal, as `validate` checks.
        resize: How pictures are made smaller: "area" averages, so that no wall vanishes; "original"
            loses walls, as the authors do (see `labyrinth_core.pictures.observations.RESIZES`).
        labyrinths: Number of labyrinths: the first of the split, or of those that match `where`;
            None for all.
        where: A filter of the table of labyrinths, such as `pyarrow.compute.field("moves") >= 12`
            (see `labyrinth_core.data.format.TABLE_COLUMNS`).

    Raises:
        ValueError: An argument has a value that is not allowed.
        DatasetError: The dataset or split does not exist, or its rows do not form episodes.
    """
    query = Query(Source(source, config, revision), split).filter(where, labyrinths=labyrinths)
    return episodes_in(query, ObservationSpec(observation, image_size, draw, resize))


def episodes_in(query: Query, spec: ObservationSpec) -> Generator[LoadedEpisode]:
    """Yield the episodes that a query requests, in order; see `load_episodes`."""
    part = query.part()
    rows = part.rows(pictures=spec.decodes)
    blocks = together(rows, spec, part.config)
    return (episode.copy() for block in blocks for episode in block.loaded(block.observed(spec)))


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

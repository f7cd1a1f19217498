"""Load datasets from a folder or the Hub, as episodes or transitions (s, a, s').

    from labyrinth_core import load_transitions

    transitions = load_transitions("data/labyrinth", "5x5", split="train", image_size=64)
    s, a, s_next = transitions[0]

No transition crosses the end of an episode. Files, local or from the Hub, are parsed, never
executed.
"""

from __future__ import annotations

import warnings
from collections.abc import Generator, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any, Literal, NamedTuple, overload

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.data.cache import (
    Columns,
    cached,
    joined_columns,
    mapped,
    name_of,
    user_folder,
)
from labyrinth_core.data.dataset import Filter, Part, Query, Source
from labyrinth_core.data.dataset_config import DatasetConfig
from labyrinth_core.data.episodes import Episodes, LoadedEpisode, replayed
from labyrinth_core.data.format import OTHERS
from labyrinth_core.data.rows import Rows
from labyrinth_core.errors import DatasetError
from labyrinth_core.pictures import DEFAULT_IMAGE_SIZE, ObservationSpec


class Transition(NamedTuple):
    """One step: state, action, next state."""

    observation: NDArray[Any]
    action: int
    next_observation: NDArray[Any]


class TransitionBatch(NamedTuple):
    """Several steps, along the first axis of each array."""

    observation: NDArray[Any]
    action: NDArray[np.int64]
    next_observation: NDArray[Any]


@dataclass(frozen=True, eq=False)
class Transitions:
    """All transitions of a split, in order; a map-style dataset for a `DataLoader`.

    Each state is stored once and shared by consecutive transitions, so all arrays are read-only.
    Arrays from the cache are pickled as the names of their files.
    """

    frames: NDArray[Any]
    """Observations of all states of all episodes, one after the other, shape (M, ...)."""
    rows: NDArray[np.int64]
    """Index in `frames` of each transition's state, shape (N,); the next state follows it."""
    actions: NDArray[np.int64]
    """Actions taken, shape (N,)."""
    rewards: NDArray[np.float32]
    """Rewards received, shape (N,)."""
    terminated: NDArray[np.bool_]
    """Whether the transition ends its episode on the goal or on ice, shape (N,)."""
    labyrinth_ids: NDArray[np.int64]
    """The id of each transition's labyrinth, shape (N,); files hold it as `f"{id:016x}"`."""
    optimal: NDArray[np.bool_] | None = None
    """Which of the four actions begin a shortest route, shape (N, 4); None unless requested."""
    columns: Mapping[str, NDArray[Any]] = field(default_factory=dict)
    """The dataset's other columns (`format.OTHERS`) by name, in each transition's state, (N,)."""

    def __post_init__(self) -> None:
        own = (getattr(self, each.name) for each in fields(self) if each.name != "columns")
        for array in (*own, *self.columns.values()):
            if array is not None:
                array.setflags(write=False)

    def __len__(self) -> int:
        """Return the number of transitions, N."""
        return len(self.rows)

    def __repr__(self) -> str:
        """Return the number of transitions and labyrinths, and an observation's shape and dtype."""
        labyrinths = len(np.unique(self.labyrinth_ids))
        shape, kind = self.frames.shape[1:], self.frames.dtype
        return f"Transitions({len(self)} of {labyrinths} labyrinths; observations {shape} {kind})"

    @property
    def truncated(self) -> NDArray[np.bool_]:
        """Whether the transition ends an episode that was cut, shape (N,)."""
        return self.dones & ~self.terminated

    @property
    def dones(self) -> NDArray[np.bool_]:
        """Whether the transition ends its episode, terminated or truncated, shape (N,)."""
        # After an episode's last transition, `frames` has its last state, which has no action.
        dones: NDArray[np.bool_] = np.diff(self.rows, append=len(self.frames)) != 1
        return dones

    @property
    def episode_indices(self) -> NDArray[np.int64]:
        """The number of each transition's episode in the split, from 0, shape (N,)."""
        # Each episode before it has one state more than transitions.
        numbers: NDArray[np.int64] = self.rows - np.arange(len(self.rows))
        return numbers

    @property
    def observations(self) -> NDArray[Any]:
        """The observations before the actions, shape (N, ...); a new array."""
        return self.frames.take(self.rows, axis=0)

    @property
    def next_observations(self) -> NDArray[Any]:
        """The observations after the actions, shape (N, ...); a new array."""
        return self.frames.take(self.rows + 1, axis=0)

    @overload
    def __getitem__(self, index: int) -> Transition: ...

    @overload
    def __getitem__(self, index: slice | Sequence[int] | NDArray[np.int64]) -> TransitionBatch: ...

    def __getitem__(
        self, index: int | slice | Sequence[int] | NDArray[np.int64]
    ) -> Transition | TransitionBatch:
        """Return one transition as views of `frames`, or a batch as new arrays."""
        rows = self.rows[index]
        if isinstance(rows, np.ndarray):
            if rows.ndim != 1:  # As for True, None and arrays of two axes.
                shown = " ".join(repr(index).split())
                raise IndexError(
                    f"index={shown:.60}: give a number, a slice, or one axis of numbers or booleans"
                )
            return TransitionBatch(
                self.frames.take(rows, axis=0),
                np.array(self.actions[index]),
                self.frames.take(rows + 1, axis=0),
            )
        return Transition(self.frames[rows], int(self.actions[index]), self.frames[rows + 1])

    def __getitems__(self, indices: Sequence[int]) -> list[Transition]:
        """Return copies of several transitions; a `DataLoader` calls this for a batch.

        Read-only views would make tensors that must not be written to.
        """
        batch = self[np.asarray(indices, np.int64)]
        steps = zip(batch.observation, batch.action.tolist(), batch.next_observation, strict=True)
        return [Transition(*step) for step in steps]

    def __iter__(self) -> Iterator[Transition]:
        """Yield all transitions in order."""
        return (self[index] for index in range(len(self)))

    def __reduce__(self) -> tuple[object, ...]:
        """Return how to pickle the transitions; whole arrays of a cache become file names."""
        sent = {name: _sent(array) for name, array in self.columns.items()}
        return _received, (sent, *(_sent(getattr(self, each.name)) for each in fields(self)[:-1]))


def _transitions(arrays: Columns) -> Transitions:
    """Return the transitions of a cache's arrays."""
    own: dict[str, Any] = dict(arrays)
    own["columns"] = {column.name: own.pop(column.name) for column in OTHERS}
    return Transitions(**own)


def _sent(array: NDArray[Any] | None) -> NDArray[Any] | str | None:
    """Return an array, or the name of its file if it is the whole array of a cache."""
    base = None if array is None else array.base
    if array is None or not isinstance(base, np.memmap) or base.flags.writeable:
        return array
    whole = (array.dtype, array.shape) == (base.dtype, base.shape) and array.flags.c_contiguous
    return str(base.filename) if whole and str(base.filename).endswith(".npy") else array


def _received(columns: Mapping[str, Any], *sent: Any) -> Transitions:
    own = {name: _mapped(array) for name, array in columns.items()}
    return Transitions(*(*map(_mapped, sent), own))


def _mapped(sent: Any) -> Any:
    if not isinstance(sent, str):
        return sent
    path = sent
    try:
        return mapped(path)
    except (OSError, ValueError) as error:
        raise DatasetError(f"{path} is gone since it was loaded: {error}") from error


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
    blocks = part.replayed(pictures=False)
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
        return _transitions(cached(folder / name, shape, _observed(part, spec)))
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
    return _transitions({"frames": shown, **joined_columns(columns)})


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

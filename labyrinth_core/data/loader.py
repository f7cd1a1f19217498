"""Loading of datasets from a folder or the Hub, as episodes or transitions (s, a, s').

    from labyrinth_core import load_transitions

    transitions = load_transitions("data/labyrinth", "5x5", split="train", image_size=64)
    s, a, s_next = transitions[0]

No transition crosses the end of an episode. Files and the content of the Hub are parsed, never
evaluated.
"""

from __future__ import annotations

import hashlib
import json
import sys
import warnings
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from dataclasses import KW_ONLY, dataclass, replace
from functools import wraps
from inspect import signature
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.data import frame_cache
from labyrinth_core.data.episodes import Episodes, replayed
from labyrinth_core.data.errors import DatasetError
from labyrinth_core.data.observations import PICTURES_VERSION, ObservationSpec
from labyrinth_core.data.rows import Rows, of_labyrinths
from labyrinth_core.data.source import (
    Filter,
    Part,
    find_numbers,
    find_part,
    local_folder,
    stream_rows,
)
from labyrinth_core.data.transitions import (
    Columns,
    LoadedEpisode,
    Transition,
    Transitions,
    columns_of,
    joined_columns,
    loaded,
)

DEFAULT_IMAGE_SIZE = 64
"""Pixels on each side of the observations of the benchmark's baselines (supplement, section 1)."""

P = ParamSpec("P")
AnyRequest = TypeVar("AnyRequest")
Result = TypeVar("Result")


@dataclass(frozen=True)
class Request:
    """What to load; `load_episodes` explains the fields."""

    source: str | Path
    config: str
    _: KW_ONLY
    split: str = "train"
    observation: str = "image"
    image_size: int = DEFAULT_IMAGE_SIZE
    revision: str | None = None
    draw: bool = False
    resize: str = "area"
    labyrinths: int | None = None
    where: Filter | None = None

    def spec(self) -> ObservationSpec:
        """Return how states are observed; raise ValueError for a value that is not allowed."""
        return ObservationSpec(self.observation, self.image_size, self.draw, self.resize)

    def _where(self) -> tuple[Any, ...]:
        return self.source, self.config, self.split, self.revision, self.labyrinths, self.where

    def part(self) -> Part:
        """Return the part of the dataset to read, with all its files in a folder."""
        return find_part(*self._where())

    def streamed(self, *, pictures: bool) -> Iterator[Rows]:
        """Return the rows as they are downloaded, or those of a folder."""
        if local_folder(self.source, self.config, self.revision) is not None:
            return self.part().rows(pictures=pictures)
        numbers = find_numbers(*self._where())
        source = str(self.source)
        rows = stream_rows(source, self.config, self.split, self.revision, pictures=pictures)
        return of_labyrinths(rows, numbers)


@dataclass(frozen=True)
class TransitionsRequest(Request):
    """What to load and where to keep it; `load_transitions` explains the fields."""

    _: KW_ONLY
    cache_dir: str | Path | bool | None = True
    optimal: bool = False

    def cache(self) -> Path | None:
        """Return the folder of the cache file, None for no cache; raise OSError if unknown."""
        if self.observation != "image" or self.cache_dir is None or self.cache_dir is False:
            return None
        if self.cache_dir is True:
            return frame_cache.user_folder()
        return Path(self.cache_dir).expanduser()


def _asked_by(
    request: Callable[P, AnyRequest],
) -> Callable[[Callable[[AnyRequest], Result]], Callable[P, Result]]:
    """Give a function of a request the fields of the request as arguments, `help` included."""

    def decorate(function: Callable[[AnyRequest], Result]) -> Callable[P, Result]:
        returned = signature(function).return_annotation
        shown = signature(request).replace(return_annotation=returned)

        @wraps(function)
        def asked(*args: P.args, **kwargs: P.kwargs) -> Result:
            try:
                shown.bind(*args, **kwargs)
            except TypeError as error:  # Which would name the class of the request.
                raise TypeError(f"{function.__name__}() {error}") from None
            return function(request(*args, **kwargs))

        asked.__signature__ = shown  # type: ignore[attr-defined]
        return asked

    return decorate


@_asked_by(TransitionsRequest)
def load_transitions(request: TransitionsRequest) -> Transitions:  # noqa: D417
    """Return all transitions of a split.

    Pictures are made once and kept in a cache file, which is memory-mapped from then on. Its name
    follows from the hashes of the shards in the manifest, so that a dataset built anew is read
    anew. The shards are compared with the manifest when the file is made, and are not read when it
    exists.

    Args:
        source: Folder with the dataset, or its id on the Hub; see `load_episodes` for this and
            for all arguments that are not explained here.
        config: Name of the dataset's config, such as `5x5`.
        cache_dir: Folder of the cache file. True stands for `labyrinth-datasets` in
            `$XDG_CACHE_HOME` or `~/.cache`. False or None holds everything in memory; so does, with
            a warning, a folder that cannot be written, or a full disk. A folder has 20 GB of cache
            files at most, or as many as the environment variable LABYRINTH_CACHE_GB says; those
            used least recently make room.
        optimal: Whether to find out, too, which actions were optimal, by solving each labyrinth.

    Raises:
        ValueError: An argument has a value that is not allowed.
        DatasetError: As for `load_episodes`, or there is no episode in the split, or the cache file
            would exceed its limit.
    """
    spec, cache_dir = request.spec(), request.cache_dir
    named = isinstance(cache_dir, str) and cache_dir.strip()
    if not (named or cache_dir is None or isinstance(cache_dir, bool | Path)):
        raise ValueError(f"cache_dir={cache_dir!r}: give a folder, True or False")
    part = request.part()
    found = _cached(request, part, spec) or _in_memory(part, spec)
    if not request.optimal:
        return found
    blocks = [block.optimal()[block.acting] for block in replayed(part.rows(pictures=False))]
    return replace(found, optimal=np.concatenate(blocks))


def _cached(request: TransitionsRequest, part: Part, spec: ObservationSpec) -> Transitions | None:
    """Return the transitions in a cache file, None if they are to be held in memory."""
    try:
        folder = request.cache()
        if folder is None:
            return None
        key = _key(part, spec)
        path = folder / frame_cache.name_of(part.config, request.split, spec.image_size, key)
        size = sum(shard.rows for shard in part.shards) * 3 * spec.image_size**2
        return frame_cache.load(path, key, size, lambda: _frames(part, spec))
    except OSError as error:
        reason = f"{error}; so the pictures are held in memory, as with cache_dir=False"
        warnings.warn(f"the frame cache cannot be used: {reason}", stacklevel=4)
        return None


def _frames(part: Part, spec: ObservationSpec) -> Iterator[tuple[NDArray[Any], Columns]]:
    """Yield the observations of all states, with the columns of their transitions."""
    return _observed(_parts(part.rows(pictures=spec.decodes), spec), spec)


def _in_memory(part: Part, spec: ObservationSpec) -> Transitions:
    """Return the transitions, after reading all rows, so that pictures get their room at once.

    Joining pictures that were made one part after the other takes twice as long.
    """
    blocks = list(replayed(part.rows(pictures=spec.decodes)))
    count = sum(len(block.states) for block in blocks)
    parts = (some for block in blocks for some in block.parts(spec.together))
    shape = (count, spec.image_size, spec.image_size, 3)
    pictures = np.empty(shape, np.uint8) if spec.observation == "image" else None
    frames, columns = zip(*_observed(parts, spec, pictures), strict=True)
    return Transitions(
        np.concatenate(frames) if pictures is None else pictures, **joined_columns(columns)
    )


def _observed(
    parts: Iterable[Episodes], spec: ObservationSpec, pictures: NDArray[np.uint8] | None = None
) -> Iterator[tuple[NDArray[Any], Columns]]:
    """Yield the observations of parts, in `pictures` if given, and their transitions' columns.

    Raises:
        DatasetError: There are no parts, or a picture cannot be decoded.
    """
    first = 0
    for episodes in parts:
        end = first + len(episodes.states)
        own = None if pictures is None else pictures[first:end]
        yield spec.observe(episodes, own), columns_of(episodes, first)
        first = end
    if not first:
        raise DatasetError("there is no episode in the split")


def _parts(rows: Iterator[Rows], spec: ObservationSpec, *worker: int) -> Iterator[Episodes]:
    """Yield the episodes of rows, as many together as are observed at once."""
    for block in replayed(rows, *worker):
        yield from block.parts(spec.together)


def _key(part: Part, spec: ObservationSpec, version: int = PICTURES_VERSION) -> str:
    """Return a hash of all that the content of a cache file depends on."""
    content: dict[str, Any] = {
        "shards": [shard.sha256 for shard in part.shards],
        "image_size": int(spec.image_size),
        "drawn": spec.draw,
        "resize": spec.resize,
        "pixels": version,
    }
    if some := [each.tolist() for each in part.numbers if each is not None]:
        content["labyrinths"] = some
    return hashlib.sha256(json.dumps(content).encode()).hexdigest()


@_asked_by(Request)
def load_episodes(request: Request) -> Generator[LoadedEpisode]:  # noqa: D417
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
            they are equal, as `validate` checks.
        resize: How pictures are made smaller: "area" averages, so that no wall vanishes; "original"
            loses walls, as the authors do (see `labyrinth_core.data.observations.RESIZES`).
        labyrinths: How many labyrinths, the first ones of the split, or of those that `where`
            leaves; None for all.
        where: A filter of the table of labyrinths, such as `pyarrow.compute.field("moves") >= 12`
            (see `labyrinth_core.data.labyrinth_table.TABLE_COLUMNS`).

    Raises:
        ValueError: An argument has a value that is not allowed.
        DatasetError: There is no such dataset or split, or its rows do not make episodes.
    """
    spec = request.spec()
    return _episodes(request.part().rows(pictures=spec.decodes), spec)


def _episodes(
    rows: Iterator[Rows], spec: ObservationSpec, *worker: int
) -> Generator[LoadedEpisode]:
    for episodes in _parts(rows, spec, *worker):
        yield from loaded(episodes, spec.observe(episodes))


@_asked_by(Request)
def stream_episodes(request: Request) -> Generator[LoadedEpisode]:
    """Yield the episodes of a split as they are downloaded, by `load_dataset(streaming=True)`.

    From a folder nothing is downloaded, and the episodes are those of `load_episodes`, made ahead.
    A thread downloads and decodes a few episodes ahead; it ends after the last episode, or when
    the generator is closed. Arguments and errors are those of `load_episodes`. Only the columns
    that are needed are downloaded.

    Called in a worker of a `DataLoader`, it yields that worker's part of the episodes, so that all
    workers together yield each of them once.
    """
    spec = request.spec()
    rows = request.streamed(pictures=spec.decodes)
    return prefetched(_episodes(rows, spec, *_part_of_worker()), ahead=2)


def _part_of_worker() -> tuple[int, int]:
    """Return the number of this worker of a `DataLoader`, from 0, and how many workers there are.

    A process that has not imported torch is not a worker.
    """
    torch_data = sys.modules.get("torch.utils.data")
    worker = None if torch_data is None else torch_data.get_worker_info()
    return (0, 1) if worker is None else (worker.id, worker.num_workers)


@_asked_by(Request)
def stream_transitions(request: Request) -> Generator[Transition]:
    """Yield the transitions of a split as they are downloaded; see `stream_episodes`."""
    return _steps(stream_episodes(**vars(request)))


def _steps(episodes: Generator[LoadedEpisode]) -> Generator[Transition]:
    with closing(episodes):
        for episode in episodes:
            observations = episode.observations
            for step, action in enumerate(episode.actions.tolist()):
                yield Transition(observations[step], action, observations[step + 1])


def prefetched(items: Generator[LoadedEpisode], ahead: int) -> Generator[LoadedEpisode]:
    """Yield the items of a generator in order; a thread computes up to `ahead` items in advance.

    Its errors are raised here, in their place. After `close`, `break` or an error the generator is
    closed and the thread has ended before this returns.
    """
    end: Any = object()
    thread = ThreadPoolExecutor(max_workers=1, thread_name_prefix="prefetch")
    try:
        waiting = deque(thread.submit(next, items, end) for _ in range(ahead))
        while (item := waiting.popleft().result()) is not end:
            waiting.append(thread.submit(next, items, end))
            yield item
    finally:
        thread.shutdown(cancel_futures=True)
        items.close()

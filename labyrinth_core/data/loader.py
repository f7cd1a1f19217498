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
from collections.abc import Generator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from labyrinth_core.data import frame_cache
from labyrinth_core.data.episodes import episodes_of, optimal_actions_of
from labyrinth_core.data.manifest import Shard
from labyrinth_core.data.observations import PICTURES_VERSION, ObservationSpec
from labyrinth_core.data.replays import replays_of
from labyrinth_core.data.selection import Filter, Numbers, Part, find_numbers, find_part, rows_of
from labyrinth_core.data.source import local_folder, stream_rows
from labyrinth_core.data.transitions import (
    Keep,
    LoadedEpisode,
    Transition,
    Transitions,
    collect,
    gather,
)

DEFAULT_IMAGE_SIZE = 64
"""Pixels on each side of the observations of the benchmark's baselines (supplement, section 1)."""


def load_transitions(
    source: str | Path,
    config: str,
    *,
    split: str = "train",
    observation: str = "image",
    image_size: int = DEFAULT_IMAGE_SIZE,
    revision: str | None = None,
    draw: bool = False,
    resize: str = "area",
    cache_dir: str | Path | bool | None = True,
    labyrinths: int | None = None,
    where: Filter | None = None,
    optimal: bool = False,
) -> Transitions:
    """Return all transitions of a split.

    Pictures are made once and kept in a cache file, which is memory-mapped from then on. Its name
    follows from the hashes of the shards in the manifest, so that a dataset built anew is read
    anew. The shards are compared with the manifest when the file is made, and are not read when it
    exists.

    Args:
        source: Folder with the dataset, or its id on the Hub; see `load_episodes` for this, the
            next seven, `labyrinths` and `where`.
        config: Name of the dataset's config, such as `5x5`.
        split: Name of the split, such as `train`.
        observation: "image", "vector" or "text".
        image_size: Pixels on each side of the pictures.
        revision: Branch, tag or commit on the Hub.
        draw: Whether pictures are drawn instead of decoded.
        resize: How pictures are made smaller.
        cache_dir: Folder of the cache file. True stands for `labyrinth-datasets` in
            `$XDG_CACHE_HOME` or `~/.cache`. False or None holds all in memory; so does, with a
            warning, a folder that cannot be written, or a full disk. Its cache files have 20 GB
            at most, or as many as the environment variable LABYRINTH_CACHE_GB says; those used
            least recently make room.
        labyrinths: How many labyrinths, the first ones.
        where: A filter of the table of labyrinths.
        optimal: Whether to find out, too, which actions were optimal, by solving each labyrinth.

    Raises:
        ValueError: An argument is none of the allowed values.
        DatasetError: As for `load_episodes`, or there is no episode in the split, or the cache may
            not have so much.
    """
    spec = ObservationSpec(observation, image_size, draw, resize)
    named = isinstance(cache_dir, str) and cache_dir.strip()
    if not (named or cache_dir is None or isinstance(cache_dir, bool | Path)):
        raise ValueError(f"cache_dir={cache_dir!r}: give a folder, True or False")
    part = find_part(source, config, split, revision, labyrinths, where)
    found = _transitions(part, split, spec, cache_dir)
    if not optimal:
        return found
    return replace(found, optimal=optimal_actions_of(part.rows(pictures=False)))


def _transitions(
    part: Part, split: str, spec: ObservationSpec, cache_dir: str | Path | bool | None
) -> Transitions:
    def fill(keep: Keep, *, at_once: bool = False) -> dict[str, NDArray[Any]]:
        columns = part.columns() if spec.draws_many else None
        replays = None if columns is None else replays_of(columns)
        if replays is None:
            return gather(episodes_of(part.rows(pictures=spec.decodes), spec), keep)
        return replays.fill(keep, spec, at_once=at_once)

    if spec.observation == "image" and cache_dir is not None and cache_dir is not False:
        try:
            cache = frame_cache.user_folder() if cache_dir is True else Path(cache_dir).expanduser()
            key = _key(part.shards, spec, numbers=part.numbers)
            path = cache / frame_cache.name_of(part.config, split, spec.image_size, key)
            size = sum(shard.rows for shard in part.shards) * 3 * spec.image_size**2
            return frame_cache.load(path, key, size, fill)
        except OSError as error:
            reason = f"{error}; so the pictures are held in memory, as with cache_dir=False"
            warnings.warn(f"the frame cache cannot be used: {reason}", stacklevel=3)
    return collect(partial(fill, at_once=True))


def _key(
    shards: Sequence[Shard],
    spec: ObservationSpec,
    version: int = PICTURES_VERSION,
    numbers: Sequence[Numbers | None] = (),
) -> str:
    """Return a hash of all that the content of a cache file depends on."""
    content: dict[str, Any] = {
        "shards": [shard.sha256 for shard in shards],
        "image_size": int(spec.image_size),
        "drawn": spec.draw,
        "resize": spec.resize,
        "pixels": version,
    }
    if some := [each.tolist() for each in numbers if each is not None]:
        content["labyrinths"] = some
    return hashlib.sha256(json.dumps(content).encode()).hexdigest()


def load_episodes(
    source: str | Path,
    config: str,
    *,
    split: str = "train",
    observation: str = "image",
    image_size: int = DEFAULT_IMAGE_SIZE,
    revision: str | None = None,
    draw: bool = False,
    resize: str = "area",
    labyrinths: int | None = None,
    where: Filter | None = None,
) -> Generator[LoadedEpisode]:
    """Yield the episodes of a split, in order.

    Args:
        source: Folder with the dataset, or its id on the Hub such as `user/labyrinth`.
        config: Name of the dataset's config, such as `5x5` or `5x5-key_and_door`.
        split: One of train, validation, test, random, s0, s0_and_g.
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
        ValueError: An argument is none of the allowed values.
        DatasetError: There is no such dataset or split, or its rows do not make episodes.
    """
    spec = ObservationSpec(observation, image_size, draw, resize)
    part = find_part(source, config, split, revision, labyrinths, where)
    return episodes_of(part.rows(pictures=spec.decodes), spec)


def stream_episodes(
    source: str | Path,
    config: str,
    *,
    split: str = "train",
    observation: str = "image",
    image_size: int = DEFAULT_IMAGE_SIZE,
    revision: str | None = None,
    draw: bool = False,
    resize: str = "area",
    labyrinths: int | None = None,
    where: Filter | None = None,
) -> Generator[LoadedEpisode]:
    """Yield the episodes of a split as they are downloaded, by `load_dataset(streaming=True)`.

    From a folder nothing is downloaded, and they are those of `load_episodes`, made ahead.
    A thread downloads and decodes a few episodes ahead; it ends after the last episode, or when
    the generator is closed. Arguments and errors are those of `load_episodes`. Only the columns
    that are needed are downloaded.

    Called in a worker of a `DataLoader`, it yields that worker's part of the episodes, so that all
    workers together yield each of them once.
    """
    spec = ObservationSpec(observation, image_size, draw, resize)
    folder = local_folder(source, config, revision)
    if folder is None:
        numbers = find_numbers(source, config, split, revision, labyrinths, where)
        rows = stream_rows(str(source), config, split, revision, pictures=spec.decodes)
        rows = rows_of(rows, numbers)
    else:
        part = find_part(source, config, split, revision, labyrinths, where)
        rows = part.rows(pictures=spec.decodes)
    return prefetched(episodes_of(rows, spec, *_part_of_worker()), ahead=2)


def _part_of_worker() -> tuple[int, int]:
    """Return the number of this worker of a `DataLoader`, from 0, and how many workers there are.

    A process that has not imported torch is none.
    """
    torch_data = sys.modules.get("torch.utils.data")
    worker = None if torch_data is None else torch_data.get_worker_info()
    return (0, 1) if worker is None else (worker.id, worker.num_workers)


def stream_transitions(
    source: str | Path,
    config: str,
    *,
    split: str = "train",
    observation: str = "image",
    image_size: int = DEFAULT_IMAGE_SIZE,
    revision: str | None = None,
    draw: bool = False,
    resize: str = "area",
    labyrinths: int | None = None,
    where: Filter | None = None,
) -> Generator[Transition]:
    """Yield the transitions of a split as they are downloaded; see `stream_episodes`."""
    episodes = stream_episodes(
        source,
        config,
        split=split,
        observation=observation,
        image_size=image_size,
        revision=revision,
        draw=draw,
        resize=resize,
        labyrinths=labyrinths,
        where=where,
    )
    return _steps(episodes)


def _steps(episodes: Generator[LoadedEpisode]) -> Generator[Transition]:
    with closing(episodes):
        for episode in episodes:
            observations = episode.observations
            for step, action in enumerate(episode.actions.tolist()):
                yield Transition(observations[step], action, observations[step + 1])


def prefetched(items: Generator[LoadedEpisode], ahead: int) -> Generator[LoadedEpisode]:
    """Yield the items of a generator in order; a thread runs it so many items ahead, 1 or more.

    Its errors are raised here, in their place. After `close`, `break` or an error the generator is
    closed and the thread ended before this returns.
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

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
import warnings
from collections import deque
from collections.abc import Generator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from pathlib import Path
from typing import Any

from labyrinth_core.data import frame_cache
from labyrinth_core.data.episodes import episodes_of
from labyrinth_core.data.manifest import Manifest, Shard
from labyrinth_core.data.observations import PICTURES_VERSION, ObservationSpec
from labyrinth_core.data.source import local_folder, locate, read_rows, stream_rows
from labyrinth_core.data.transitions import LoadedEpisode, Transition, Transitions, collect

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
) -> Transitions:
    """Return all transitions of a split.

    Pictures are made once and kept in a cache file, which is memory-mapped from then on. Its name
    follows from the hashes of the shards in the manifest, so that a dataset built anew is read
    anew. The shards are compared with the manifest when the file is made, and are not read when it
    exists.

    Args:
        source: Folder with the dataset, or its id on the Hub; see `load_episodes` for this and the
            next seven.
        config: Name of the dataset's config, such as `5x5`.
        split: Name of the split, such as `train`.
        observation: "image", "vector" or "text".
        image_size: Pixels on each side of the pictures.
        revision: Branch, tag or commit on the Hub.
        draw: Whether pictures are drawn instead of decoded.
        resize: How pictures are made smaller.
        cache_dir: Folder of the cache file. True stands for `labyrinth-datasets` in
            `$XDG_CACHE_HOME` or `~/.cache`. False or None holds all in memory; so does, with a
            warning, a folder that cannot be written, or a full disk.

    Raises:
        ValueError: An argument is none of the allowed values.
        DatasetError: As for `load_episodes`, or there is no episode in the split.
    """
    spec = ObservationSpec(observation, image_size, draw, resize)
    folder = locate(source, config, split, revision)
    manifest = Manifest.read(folder)
    shards = manifest.of(split)

    def episodes() -> Generator[LoadedEpisode]:
        return episodes_of(read_rows(folder, shards, pictures=spec.decodes), spec)

    if observation == "image" and cache_dir is not None and cache_dir is not False:
        try:
            cache = frame_cache.user_folder() if cache_dir is True else Path(cache_dir).expanduser()
            key = _key(shards, spec)
            name = f"{manifest.config.name}-{split}-{image_size}-{key[:16]}{frame_cache.SUFFIX}"
            return frame_cache.load(cache / name, key, episodes)
        except OSError as error:
            reason = f"{error}; so the pictures are held in memory, as with cache_dir=False"
            warnings.warn(f"the frame cache cannot be used: {reason}", stacklevel=2)
    return collect(episodes())


def _key(shards: Sequence[Shard], spec: ObservationSpec, version: int = PICTURES_VERSION) -> str:
    """Return a hash of all that the content of a cache file depends on."""
    content = {
        "shards": [shard.sha256 for shard in shards],
        "image_size": spec.image_size,
        "drawn": spec.draw,
        "resize": spec.resize,
        "pixels": version,
    }
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

    Raises:
        ValueError: An argument is none of the allowed values.
        DatasetError: There is no such dataset or split, or its rows do not make episodes.
    """
    spec = ObservationSpec(observation, image_size, draw, resize)
    folder = locate(source, config, split, revision)
    shards = Manifest.read(folder).of(split)
    return episodes_of(read_rows(folder, shards, pictures=spec.decodes), spec)


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
) -> Generator[LoadedEpisode]:
    """Yield the episodes of a split as they are downloaded, by `load_dataset(streaming=True)`.

    A thread downloads and decodes a few episodes ahead; it ends after the last episode, or when
    the generator is closed. Arguments and errors are those of `load_episodes`. Only the columns
    that are needed are downloaded.
    """
    spec = ObservationSpec(observation, image_size, draw, resize)
    folder = local_folder(source, config, revision)
    if folder is not None:
        Manifest.read(folder).of(split)  # Raises if there is no such split.
    source = str(source if folder is None else folder.parent)
    rows = stream_rows(source, config, split, revision, pictures=spec.decodes)
    return prefetched(episodes_of(rows, spec), ahead=2)


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

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
from collections.abc import Generator, Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.data import frame_cache
from labyrinth_core.data.dataset_config import DatasetConfig
from labyrinth_core.data.episodes import Episodes, replayed
from labyrinth_core.data.errors import DatasetError
from labyrinth_core.data.observations import PICTURES_VERSION, ObservationSpec
from labyrinth_core.data.part import Filter, Part, Wanted, find_part
from labyrinth_core.data.rows import Rows
from labyrinth_core.data.transitions import (
    Columns,
    LoadedEpisode,
    Transitions,
    columns_of,
    joined_columns,
    loaded,
)
from labyrinth_core.pictures.png import DEFAULT_IMAGE_SIZE


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
    spec = ObservationSpec(observation, image_size, draw, resize)
    named = isinstance(cache_dir, str) and cache_dir.strip()
    if not (named or cache_dir is None or isinstance(cache_dir, bool | Path)):
        raise ValueError(f"cache_dir={cache_dir!r}: give a folder, True or False")
    wanted = Wanted(source, config, split, revision, labyrinths, where)
    part = find_part(wanted)
    found = None
    if observation == "image" and cache_dir is not None and cache_dir is not False:
        found = _cached(cache_dir, split, part, spec)
    if found is None:
        found = _in_memory(part, spec)
    if not optimal:
        return found
    blocks = replayed(part.rows(pictures=False), part.config)
    acting = [block.optimal()[block.acting] for block in blocks]
    return replace(found, optimal=np.concatenate(acting))


def _cached(
    cache_dir: str | Path | Literal[True], split: str, part: Part, spec: ObservationSpec
) -> Transitions | None:
    """Return the transitions in a cache file, None if they are to be held in memory."""
    try:
        folder = frame_cache.user_folder() if cache_dir is True else Path(cache_dir).expanduser()
        key, size = _key(part, spec), int(spec.image_size)
        path = folder / frame_cache.name_of(part.folder.name, split, size, key)
        content = _observed(_parts(part.rows(pictures=spec.decodes), spec, part.config), spec)
        return frame_cache.load(path, key, (len(part), size, size, 3), content)
    except OSError as error:
        reason = f"{error}; so the pictures are held in memory, as with cache_dir=False"
        warnings.warn(f"the frame cache cannot be used: {reason}", stacklevel=3)
        return None


def _in_memory(part: Part, spec: ObservationSpec) -> Transitions:
    """Return the transitions, after reading all rows, so that pictures get their room at once.

    Joining pictures that were made one part after the other takes twice as long.
    """
    blocks = list(replayed(part.rows(pictures=spec.decodes), part.config))
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


def _parts(
    rows: Iterable[Rows], spec: ObservationSpec, config: DatasetConfig | None
) -> Iterator[Episodes]:
    """Yield the episodes of rows, as many together as are observed at once."""
    for block in replayed(rows, config):
        yield from block.parts(spec.together)


def _key(part: Part, spec: ObservationSpec) -> str:
    """Return a hash of all that the content of a cache file depends on."""
    content: dict[str, Any] = {
        "shards": [shard.sha256 for shard in part.shards],
        "image_size": int(spec.image_size),
        "drawn": spec.draw,
        "resize": spec.resize,
        "pixels": PICTURES_VERSION,
    }
    if part.kept is not None:
        content["rows"] = hashlib.sha256(np.packbits(part.kept).tobytes()).hexdigest()
    return hashlib.sha256(json.dumps(content).encode()).hexdigest()


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
    spec = ObservationSpec(observation, image_size, draw, resize)
    wanted = Wanted(source, config, split, revision, labyrinths, where)
    part = find_part(wanted)
    return episodes_of(part.rows(pictures=spec.decodes), spec, part.config)


def episodes_of(
    rows: Iterable[Rows], spec: ObservationSpec, config: DatasetConfig | None = None
) -> Generator[LoadedEpisode]:
    """Yield the episodes that rows make; see `replayed`."""
    for episodes in _parts(rows, spec, config):
        yield from loaded(episodes, spec.observe(episodes))

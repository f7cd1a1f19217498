"""The part of `corpus.py` that runs in each tree: hash loaded data, build a dataset in memory.

It also has the random policy of the evaluations. It imports only public names, of the tree that
PYTHONPATH names, so that it runs in any tree:

    PYTHONPATH=TREE python scripts/corpus_part.py loads loads.json
    PYTHONPATH=TREE python scripts/corpus_part.py memory data/memory
"""

from __future__ import annotations

import hashlib
import json
import pickle
import sys
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

import fsspec
import numpy as np
import pyarrow.compute as pc
from numpy.typing import NDArray

import labyrinth_core as lib
from labyrinth_core import (
    load_arrays,
    load_episodes,
    load_transitions,
    stream_episodes,
    stream_transitions,
)

LOADED = {
    "plain": ("3x3", ("train", "random", "s0")),
    "key": ("4x4-key_and_door", ("train", "random", "thin_walls")),
    "ice": ("5x5-icy_floor", ("train", "random", "recoloured")),
    "partial": ("4x6-partial_observability", ("train", "validation", "random")),
    "shifted": ("5x5", ("train", "random", "longer")),
}
"""Dataset of the corpus -> its config, and the splits to load in every way."""

LONG = {
    "shards": ("20x20", ("train", "s0")),
    "long": ("100x100", ("train", "random")),
}
"""The same for datasets with several shards, or with episodes longer than a row group."""

MOVES = pc.field("moves") >= 5
"""A filter that keeps some labyrinths of every dataset."""

Loads = Iterator[tuple[str, Callable[[], Any]]]
"""The name of a load, and the call that loads."""


def chance(observations: NDArray[np.uint8], rng: np.random.Generator) -> NDArray[np.int64]:
    """Return uniformly random actions: the random policy of the evaluations."""
    return rng.integers(4, size=len(observations))


def digest(loaded: Any) -> str:
    """Return the SHA-256 of loaded data: of its arrays with their types and shapes."""
    found = hashlib.sha256()
    _add(found, loaded)
    return found.hexdigest()


def _add(found: Any, value: Any) -> None:
    """Add a value to a hash: an array, a text or a number, or an object that holds these."""
    if isinstance(value, np.ndarray):
        found.update(repr((value.dtype.str, value.shape)).encode())
        own = value.dtype.kind in "biufSU"  # The bytes of an object array are addresses.
        found.update(value.tobytes() if own else repr(value.tolist()).encode())
    elif isinstance(value, str | bool | int | float | np.generic | None):
        found.update(repr(value).encode())
    elif isinstance(value, Iterable) and not hasattr(value, "actions"):
        for item in value:
            _add(found, item)
    else:
        named = [name for name in PUBLIC if hasattr(value, name)]
        if not named:
            raise TypeError(f"{type(value).__name__} has nothing that is compared")
        for name in named:
            found.update(name.encode())
            _add(found, getattr(value, name))


PUBLIC = (
    *("frames", "rows", "observations", "next_observations", "actions", "rewards"),
    *("terminated", "truncated", "dones", "episode_indices", "labyrinth_ids", "optimal"),
    *("labyrinth_id", "info", "labyrinth", "position", "terminal", "goal", "next_state", "done"),
    *("demonstrated", "initial", "distance", "routes", "route_starts", "on_demonstration"),
)
"""The attributes of episodes, transitions and arrays to compare."""


def loads(data: Path) -> Loads:
    """Yield all loads of the corpus."""
    for name, (config, splits) in LOADED.items():
        folder = data / name
        for split in splits:
            for way, load in _ways(folder, config, split):
                yield f"{name} {split} {way}", load
        others = {path.name.split("-0")[0] for path in (folder / config).glob("*-0*.parquet")}
        for split in sorted(others.difference(splits)):
            load = partial(load_transitions, folder, config, split=split)
            yield f"{name} {split} drawn", partial(load, image_size=16, draw=True, optimal=True)
    for name, (config, splits) in LONG.items():
        for split in splits:
            for way, load in _long_ways(data / name, config, split):
                yield f"{name} {split} {way}", load


def _ways(folder: Path, config: str, split: str) -> Loads:
    """Yield the ways to load a split."""
    load = partial(load_transitions, folder, config, split=split)
    yield "image, cached", partial(load, image_size=32)
    yield "image, from the cache", partial(load, image_size=32)
    yield "image, in memory", partial(load, image_size=32, cache_dir=False)
    yield "drawn", partial(load, image_size=32, draw=True)
    yield "original resize", partial(load, image_size=32, resize="original", labyrinths=9)
    yield "vector", partial(load, observation="vector")
    yield "text", partial(load, observation="text")
    yield "optimal", partial(load, observation="vector", optimal=True)
    yield "labyrinths", partial(load, image_size=16, labyrinths=5)
    yield "where", partial(load, image_size=16, where=MOVES)
    yield "where and labyrinths", partial(load, observation="text", where=MOVES, labyrinths=1)
    yield "pickled", lambda: pickle.loads(pickle.dumps(load(image_size=32)))
    episodes = partial(load_episodes, folder, config, split=split)
    yield "episodes", partial(episodes, image_size=16, labyrinths=9)
    yield "arrays", partial(load_arrays, folder, config, split, image_size=16)
    yield from _streams(folder, config, split)


def _long_ways(folder: Path, config: str, split: str) -> Loads:
    """Yield the ways to load a split whose pictures would take too long to decode."""
    load = partial(load_transitions, folder, config, split=split)
    yield "vector", partial(load, observation="vector", labyrinths=2)
    yield "text", partial(load, observation="text", labyrinths=1)
    yield "labyrinths", partial(load, image_size=8, labyrinths=2)
    yield "where", partial(load, image_size=8, draw=True, where=pc.field("moves") >= 70)
    yield from _streams(folder, config, split)


def _streams(folder: Path, config: str, split: str) -> Loads:
    """Yield the ways to stream a split: in order, shuffled, for ranks, resumed."""
    one = partial(stream_transitions, folder, config, split=split, image_size=8, draw=True)
    some = partial(one, labyrinths=2)
    yield "stream", some
    yield "stream, shuffled", partial(some, shuffle=True, seed=1)
    yield "stream, rank 1 of 2", partial(some, shuffle=300, rank=1, world_size=2)
    yield "stream, resumed", partial(_resumed, partial(some, shuffle=100))
    episodes = partial(stream_episodes, folder, config, split=split, observation="text")
    yield "stream of episodes", partial(episodes, where=MOVES, labyrinths=1)


def _resumed(stream: Callable[[], Any]) -> list[Any]:
    """Return the items of a stream's second epoch, of which a second stream resumes the rest."""
    first, second = stream(), stream()
    first.set_epoch(1)
    begun = list(islice(iter(first), 20))
    second.load_state_dict(json.loads(json.dumps(first.state_dict())))
    return [*begun, *second]


def write_loads(file: Path) -> None:
    """Write the hashes of all loads of the datasets in `data/` as JSON."""
    hashes = {name: digest(load()) for name, load in loads(Path("data"))}
    file.write_text(json.dumps(hashes, indent=1), encoding="utf-8")


def build_in_memory(folder: Path) -> None:
    """Build a dataset in the memory of this process, and copy its files to a folder."""
    from pipeline.__main__ import main

    place = "memory://corpus"
    sys.argv = ["run.py", "size=3", "stages=build", f"data_dir={place}", "workers=1"]
    status = main()
    if status:
        sys.exit(status)
    fsspec.filesystem("memory").get("/corpus/", f"{folder}/", recursive=True)


if __name__ == "__main__":
    print(f"labyrinth_core of {Path(lib.__file__).parents[1]}")
    {"loads": write_loads, "memory": build_in_memory}[sys.argv[1]](Path(sys.argv[2]))

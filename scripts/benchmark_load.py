"""Measure how fast transitions (s, a, s') at 64 x 64 are loaded, beside `datasets` and Pillow.

    python scripts/benchmark_load.py [--labyrinths N] [--rounds N] [--quick] [--streams]

The baseline is what one writes with the library `datasets` alone: a row, whose picture is decoded
by Pillow and resized by area (`Image.BOX`) to an array. In random order each transition takes two
rows; in order each row is decoded once and paired with the one before.

Ours are the following, each timed until every transition has been in an array once:

    cold      `load_transitions` with an empty cache, and with the process's caches of pictures
              cleared; then all transitions in batches of 64
    warm      batches of 64, copied from the cache into arrays of their own
    views     one transition at a time, its arrays being views of the cache; a byte of each is read
    stream    `stream_transitions`, in order and shuffled
    torch     a `DataLoader` with its own collation, batches of 64 (if torch is installed), whose
              workers are running already; "gathered" lets the dataset make the batches

With `--streams` these are measured alone, beside the streams of `datasets`, in CPU time.

In each round everyone is timed once, so that a busy machine slows all of them alike; a ratio is the
median of the rounds' ratios to the baseline of the same order. The dataset is the split train of
5x5, built for the run; its files are in the page cache.
"""

from __future__ import annotations

import random
import shutil
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Iterator
from functools import partial
from itertools import count, islice, pairwise
from pathlib import Path
from typing import Any

import numpy as np
from measuring import (
    forget,
    machine,
    parser_of,
    per_second,
    positive,
    report,
    run_command,
    take_turns,
)

from labyrinth_core.data.load import Transitions, load_transitions
from labyrinth_core.data.stream import stream_transitions

SIZE = 64
BATCH = 64
CONFIG = "5x5"

# The baseline.


def small(row: dict[str, Any]) -> np.ndarray[Any, np.dtype[np.uint8]]:
    """Return the picture of a row, resized by area."""
    from PIL import Image

    return np.asarray(row["obs"].resize((SIZE, SIZE), Image.Resampling.BOX))


def random_rows(dataset: Any, pairs: int, numbers: Iterator[int]) -> int:
    """Read transitions in random order, two rows each."""
    rng = random.Random(next(numbers))
    done = 0
    while done < pairs:
        index = rng.randrange(len(dataset) - 1)
        row = dataset[index]
        if row["actions"] != -1:
            _ = small(row), row["actions"], small(dataset[index + 1])
            done += 1
    return done


def ordered_rows(rows: Callable[[], Iterator[dict[str, Any]]], pairs: int) -> int:
    """Read transitions in order, each row once."""
    steps = pairwise((small(row), row["actions"]) for row in rows())
    return sum(1 for _ in islice((step for step in steps if step[0][1] != -1), pairs))


# Ours.


def batches(transitions: Transitions, *, shuffled: bool) -> int:
    """Copy all transitions into batches."""
    order = np.arange(len(transitions))
    if shuffled:
        np.random.default_rng().shuffle(order)
    return sum(
        len(transitions[order[at : at + BATCH]].action) for at in range(0, len(order), BATCH)
    )


def cold(load: Callable[..., Transitions], folder: Path, *, shuffled: bool) -> int:
    """Load with an empty cache, and go through all transitions."""
    forget()
    cache = folder / "cold"
    shutil.rmtree(cache, ignore_errors=True)
    return batches(load(cache_dir=cache), shuffled=shuffled)


def views(transitions: Transitions, *, shuffled: bool) -> int:
    """Take transitions one at a time."""
    indices = list(range(len(transitions)))
    if shuffled:
        random.shuffle(indices)
    for index in indices:
        s, _, s_next = transitions[index]
        _ = s[0, 0, 0], s_next[0, 0, 0]
    return len(indices)


def streamed(stream: Callable[[], Iterator[Any]]) -> int:
    """Go through a stream with empty caches."""
    forget()
    return sum(1 for _ in stream())


# A DataLoader.


def torch_loaders(transitions: Transitions) -> dict[str, Any]:
    """Return data loaders of torch by name, after checking that they yield all transitions."""
    try:
        from torch.utils.data import BatchSampler, DataLoader, RandomSampler
    except ImportError:
        print("torch is not installed: no data loaders")
        return {}

    def loader(workers: int, method: str | None = None, *, gathered: bool = False) -> Any:
        kept = {"persistent_workers": True, "multiprocessing_context": method} if workers else {}
        if gathered:
            sampler = BatchSampler(RandomSampler(transitions), BATCH, drop_last=False)
            return DataLoader(
                transitions, batch_size=None, sampler=sampler, num_workers=workers, **kept
            )
        return DataLoader(transitions, batch_size=BATCH, shuffle=True, num_workers=workers, **kept)

    loaders = {
        "torch, 0 workers": loader(0),
        "torch, 0 workers, gathered": loader(0, gathered=True),
        "torch, 2 workers, forked": loader(2, "fork"),
        "torch, 2 workers, spawned": loader(2, "spawn"),
        "torch, 2 workers, gathered": loader(2, "fork", gathered=True),
        "torch, 4 workers, forked": loader(4, "fork"),
    }
    actions, pixels = int(transitions.actions.sum()), int(transitions.observations.sum())
    for name, each in loaders.items():
        got = [(int(action.sum()), int(s.sum())) for s, action, _ in each]
        if tuple(map(sum, zip(*got, strict=True))) != (actions, pixels):
            sys.exit(f"{name}: other transitions than those of the dataset")
    return loaders


def epoch(loader: Any) -> int:
    """Go through all batches of a data loader."""
    return sum(len(action) for _, action, _ in loader)


def contestants(
    folder: Path, data_dir: Path, pairs: int
) -> dict[str, dict[str, Callable[[], int]]]:
    """Return what is measured, by order and name; the first of each order is its baseline."""
    from datasets import load_dataset

    rows = load_dataset(str(data_dir), CONFIG, split="train", cache_dir=str(folder / "arrow"))
    load = partial(load_transitions, data_dir, CONFIG, image_size=SIZE)
    warm = load(cache_dir=folder / "warm")
    in_both = {
        "cold, decoded": partial(cold, load, folder),
        "cold, drawn": partial(cold, partial(load, draw=True), folder),
        "warm, batches": partial(batches, warm),
        "warm, views": partial(views, warm),
    }
    shuffled = {
        "datasets, random": partial(random_rows, rows, pairs, count()),
        **{f"{name}, random": partial(each, shuffled=True) for name, each in in_both.items()},
        **{name: partial(epoch, each) for name, each in torch_loaders(warm).items()},
    }
    ordered = {
        "datasets, in order": partial(ordered_rows, lambda: iter(rows), 2 * pairs),
        **{f"{name}, in order": partial(each, shuffled=False) for name, each in in_both.items()},
        **streams(data_dir, pairs),
    }
    return {"random": shuffled, "in order": ordered}


def streams(data_dir: Path, pairs: int) -> dict[str, Callable[[], int]]:
    """Return the streams by name, those of `datasets` first; "row groups" is after `reshard`."""
    from datasets import load_dataset

    theirs = partial(load_dataset, str(data_dir), CONFIG, split="train", streaming=True)
    ours = partial(stream_transitions, data_dir, CONFIG, image_size=SIZE)
    return {
        "datasets, stream": partial(ordered_rows, lambda: iter(theirs()), 2 * pairs),
        "datasets, stream, row groups": partial(
            ordered_rows, lambda: iter(theirs().reshard()), 2 * pairs
        ),
        "stream, decoded": partial(streamed, ours),
        "stream, decoded, shuffled": partial(streamed, partial(ours, shuffle=True)),
        "stream, drawn": partial(streamed, partial(ours, draw=True)),
        "stream, drawn, shuffled": partial(streamed, partial(ours, draw=True, shuffle=True)),
    }


def main() -> None:
    """Measure and report."""
    parser = parser_of(__doc__, rounds=7)
    parser.add_argument("--labyrinths", type=positive, default=1_000, help="in the split train")
    parser.add_argument("--pairs", type=positive, default=200, help="transitions of datasets")
    parser.add_argument("--streams", action="store_true", help="measure streams alone")
    arguments = parser.parse_args()
    if arguments.quick:
        arguments.labyrinths, arguments.pairs, arguments.rounds = 100, 50, 2
    warnings.filterwarnings("ignore", message="This DataLoader will create")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        options = ["size=5", f"labyrinths={arguments.labyrinths}", "random_steps=1"]
        run_command("stages=[build]", *options, f"data_dir={folder / 'data'}")
        libraries = ("numpy", "pillow", "pyarrow", "datasets", "torch")
        about = f"{arguments.labyrinths:,} labyrinths, {arguments.rounds} rounds"
        print(f"{machine(*libraries)}; {about}")
        place = folder / "data", arguments.pairs
        found = {"": streams(*place)} if arguments.streams else contestants(folder, *place)
        for by_name in found.values():
            baseline, *others = by_name
            clock = time.process_time if arguments.streams else time.perf_counter
            passed = {name: per_second(each, clock) for name, each in by_name.items()}
            measured = take_turns(passed, arguments.rounds)
            report(measured, dict.fromkeys(others, baseline), "(s, a, s') a second")


if __name__ == "__main__":
    main()

"""Measure how fast transitions (s, a, s') at 64 x 64 are loaded, compared with `datasets`.

    python scripts/benchmark_load.py [--labyrinths N] [--rounds N] [--quick] [--streams]
    python scripts/benchmark_load.py --against FOLDER [--labyrinths N] [--rounds N] [--quick]

The baseline is a user's code with the library `datasets` alone: the picture of a row is decoded by
Pillow and resized by area (`Image.BOX`) to an array. In random order each transition reads two
rows; in order each row is decoded once and paired with the previous one.

Our ways are the following, each timed until every transition has been in an array once:

    cold      `load_transitions` with an empty cache, and with the process's caches of pictures
              cleared; then all transitions in batches of 64
    warm      batches of 64, copied from the cache into arrays of their own
    views     one transition at a time, as views of the cache; a byte of each is read
    stream    `stream_transitions`, in order and shuffled
    torch     a `DataLoader` with its own collation, batches of 64 (if torch is installed), whose
              workers are running already; "gathered" lets the dataset make the batches

`--streams` measures only our streams and those of `datasets`, in CPU time. `--against` compares
our ways with the same ways in another tree of the project, such as one made by `git worktree add
FOLDER COMMIT`; each runs in a process of its own, whose second call counts.

In each round each way is timed once, so that a busy machine slows all of them alike. A ratio is the
median over rounds of the ratio to the baseline of the same order. The dataset is the split train of
5x5, built for the benchmark; its files are in the page cache.
"""

from __future__ import annotations

import argparse
import os
import random
import resource
import shutil
import subprocess
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Iterator
from functools import partial
from itertools import count, islice, pairwise
from pathlib import Path
from statistics import median
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

from labyrinth_core import load_transitions, stream_transitions

SIZE = 64
BATCH = 64
CONFIG = "5x5"

# The baseline.


def small(row: dict[str, Any]) -> np.ndarray[Any, np.dtype[np.uint8]]:
    """Return the picture of a row, resized by area to 64 x 64."""
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


def batches(transitions: Any, *, shuffled: bool) -> int:
    """Copy all transitions into batches."""
    order = np.arange(len(transitions))
    if shuffled:
        np.random.default_rng().shuffle(order)
    return sum(
        len(transitions[order[at : at + BATCH]].action) for at in range(0, len(order), BATCH)
    )


def cold(load: Callable[..., Any], folder: Path, *, shuffled: bool) -> int:
    """Load with an empty cache, and go through all transitions."""
    forget()
    cache = folder / "cold"
    shutil.rmtree(cache, ignore_errors=True)
    return batches(load(cache_dir=cache), shuffled=shuffled)


def views(transitions: Any, *, shuffled: bool) -> int:
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


def torch_loaders(transitions: Any) -> dict[str, Any]:
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
            sys.exit(f"{name}: its transitions differ from the dataset")
    return loaders


def epoch(loader: Any) -> int:
    """Go through all batches of a data loader."""
    return sum(len(action) for _, action, _ in loader)


def contestants(
    folder: Path, data_dir: Path, pairs: int
) -> dict[str, dict[str, Callable[[], int]]]:
    """Return the calls to measure, by order and name; the first of each order is its baseline."""
    from datasets import load_dataset

    rows = load_dataset(str(data_dir), CONFIG, split="train", cache_dir=str(folder / "arrow"))
    warm, in_both = loads(folder, data_dir)
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


def loads(folder: Path, data_dir: Path) -> tuple[Any, dict[str, Callable[..., int]]]:
    """Return cached transitions, and our calls to measure, without the streams."""
    load = partial(load_transitions, data_dir, CONFIG, image_size=SIZE)
    warm = load(cache_dir=folder / "warm")
    return warm, {
        "cold, decoded": partial(cold, load, folder),
        "cold, drawn": partial(cold, partial(load, draw=True), folder),
        "warm, batches": partial(batches, warm),
        "warm, views": partial(views, warm),
    }


def streams(data_dir: Path, pairs: int) -> dict[str, Callable[[], int]]:
    """Return the streams by name, those of `datasets` first; "row groups" calls `reshard`."""
    from datasets import load_dataset

    theirs = partial(load_dataset, str(data_dir), CONFIG, split="train", streaming=True)
    return {
        "datasets, stream": partial(ordered_rows, lambda: iter(theirs()), 2 * pairs),
        "datasets, stream, row groups": partial(
            ordered_rows, lambda: iter(theirs().reshard()), 2 * pairs
        ),
        **our_streams(data_dir),
    }


def our_streams(data_dir: Path) -> dict[str, Callable[[], int]]:
    """Return our streams by name."""
    ours = partial(stream_transitions, data_dir, CONFIG, image_size=SIZE)
    return {
        "stream, decoded": partial(streamed, ours),
        "stream, decoded, shuffled": partial(streamed, partial(ours, shuffle=True)),
        "stream, drawn": partial(streamed, partial(ours, draw=True)),
        "stream, drawn, shuffled": partial(streamed, partial(ours, draw=True, shuffle=True)),
    }


# Two trees.


def measure_one(name: str, data_dir: Path) -> None:
    """Print the wall-clock and CPU seconds of a call, and this process's peak memory in MiB."""
    with tempfile.TemporaryDirectory() as folder:
        if name in our_streams(data_dir):
            call = our_streams(data_dir)[name]
        else:
            call = partial(loads(Path(folder), data_dir)[1][name], shuffled=False)
        call()
        begun, used = time.perf_counter(), time.process_time()
        call()
        seconds, cpu = time.perf_counter() - begun, time.process_time() - used
    print(seconds, cpu, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)


def measured_in(tree: Path, name: str, data_dir: Path) -> tuple[float, ...]:
    """Return the numbers that `measure_one` prints in a process that imports another tree."""
    command = [sys.executable, __file__, "--one", name, "--data", str(data_dir)]
    environment = os.environ | {"PYTHONPATH": str(tree)}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    return tuple(map(float, done.stdout.split()))


def against(tree: Path, data_dir: Path, rounds: int) -> None:
    """Print, for each of our ways, how many times as fast it is here as in another tree."""
    print(f"{'':28}{'seconds':>10}{'times':>8}{'range':>14}{'CPU':>8}{'MiB':>8}{'times':>8}")
    names = ["cold, decoded", "cold, drawn", "warm, batches", "warm, views"]
    for name in [*names, *our_streams(data_dir)]:
        places = {"here": Path(__file__).parents[1], "there": tree}
        turns = {key: partial(measured_in, place, name, data_dir) for key, place in places.items()}
        found = take_turns(turns, rounds)
        here, there = (np.array(found[key]) for key in ("here", "there"))
        clock, cpu, memory = (there / here).T
        print(
            f"{name:28}{median(here[:, 0]):>10.3f}{median(clock):>8.3f}"
            f"{min(clock):>8.2f}-{max(clock):.2f} {median(cpu):>8.3f}"
            f"{median(here[:, 2]):>8.0f}{1 / median(memory):>8.3f}",
            flush=True,
        )


def main() -> None:
    """Measure and report."""
    parser = parser_of(__doc__, rounds=7)
    parser.add_argument("--labyrinths", type=positive, default=1_000, help="those in train")
    parser.add_argument("--pairs", type=positive, default=200, help="read with `datasets`")
    parser.add_argument("--streams", action="store_true", help="measure streams alone")
    parser.add_argument("--against", type=Path, help="another tree of the project")
    parser.add_argument("--one", help=argparse.SUPPRESS)
    parser.add_argument("--data", type=Path, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.one:
        measure_one(arguments.one, arguments.data)
        return
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
        if arguments.against:
            against(arguments.against.resolve(), folder / "data", arguments.rounds)
            return
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

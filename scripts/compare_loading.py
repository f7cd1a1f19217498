"""Measure `load_transitions(draw=True)` with an empty cache beside another checkout of the code.

    git worktree add ../before f807d04
    python scripts/compare_loading.py ../before [--labyrinths N] [--rounds N]

Both load the splits train and random of the same dataset, 5x5 at 64 x 64, which is built for the
run; into memory (`cache_dir=False`) and into a cache file. Each code has a process of its own, and
they take turns. What counts is CPU time, of which a busy machine changes less than of the clock's.
Before each loading as much memory as it takes is written to once, since the first write to a page
that a host has taken back costs several times what loading does.

Printed are the medians of transitions a second, and of the rounds' ratios.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
from functools import partial
from pathlib import Path
from statistics import median

from benchmark_load import build
from measuring import machine, ratio, take_turns

CASES = [(split, kind) for split in ("train", "random") for kind in ("memory", "file")]

LOADING = """
import shutil, sys, time, warnings
from pathlib import Path
import numpy as np
from labyrinth_core.data.loader import load_transitions
from labyrinth_core.data.manifest import Manifest

data, cache = sys.argv[1:]
warnings.simplefilter("ignore")
for line in sys.stdin:
    split, kind = line.split()
    shutil.rmtree(cache, ignore_errors=True)
    rows = sum(shard.rows for shard in Manifest.read(Path(data, "5x5")).of(split))
    memory = np.empty(rows * 2 * 64 * 64 * 3, np.uint8)
    memory.fill(1)
    del memory
    begin = time.process_time()
    loaded = load_transitions(
        data, "5x5", split=split, draw=True, cache_dir=cache if kind == "file" else False
    )
    print(len(loaded) / (time.process_time() - begin), flush=True)
    del loaded
"""


def start(checkout: Path, folder: Path, name: str) -> subprocess.Popen[str]:
    """Start a process that loads, with the code of a checkout, what it is told to."""
    arguments = [sys.executable, "-c", LOADING, str(folder / "data"), str(folder / name)]
    environment = os.environ | {"PYTHONPATH": str(checkout), "OMP_NUM_THREADS": "1"}
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    return subprocess.Popen(arguments, cwd=checkout, env=environment, text=True, **pipes)


def loaded(process: subprocess.Popen[str], split: str, kind: str) -> float:
    """Return how many transitions a second of CPU time a process loads."""
    assert process.stdin is not None
    assert process.stdout is not None
    process.stdin.write(f"{split} {kind}\n")
    process.stdin.flush()
    return float(process.stdout.readline())


def main() -> None:
    """Measure and report."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("before", type=Path, help="the other checkout")
    parser.add_argument("--labyrinths", type=int, default=1_000, help="in the split train")
    parser.add_argument("--rounds", type=int, default=5, help="rounds; each times everyone once")
    arguments = parser.parse_args()
    if arguments.rounds < 1 or arguments.labyrinths < 1:
        parser.error("--rounds and --labyrinths: give whole numbers from 1 on")
    if not (arguments.before / "labyrinth_core").is_dir():
        parser.error(f"{arguments.before}: give a checkout of this repository")
    checkouts = {"before": arguments.before.resolve(), "now": Path(__file__).resolve().parents[1]}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        build(folder / "data", arguments.labyrinths, random_steps=100)
        processes = {each: start(path, folder, each) for each, path in checkouts.items()}
        turns = {
            (split, kind, each): partial(loaded, process, split, kind)
            for split, kind in CASES
            for each, process in processes.items()
        }
        rates = take_turns(turns, arguments.rounds)
        for process in processes.values():
            process.communicate()
    libraries = machine("numpy", "pyarrow")
    load = f"load {os.getloadavg()[0]:.0f}"
    print(f"{libraries}; {arguments.labyrinths:,} labyrinths, {arguments.rounds} rounds, {load}")
    print(f"{'split':8}{'into':8}{'before':>12}{'now':>12}{'times':>8}{'range':>14}")
    for split, kind in CASES:
        middle, extent, _ = ratio(rates[split, kind, "now"], rates[split, kind, "before"], target=0)
        medians = (f"{median(rates[split, kind, each]):>12,.0f}" for each in checkouts)
        print(f"{split:8}{kind:8}{''.join(medians)}{middle:>8}{extent:>14}")


if __name__ == "__main__":
    main()

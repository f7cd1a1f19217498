"""Build a million labyrinths at 5x5, measure time and memory, and certify the splits.

    python scripts/benchmark_million.py --data-dir million --workers 2
    python scripts/benchmark_million.py --data-dir small --labyrinths 30000

A third of the labyrinths is in each of train, validation and test; random, s0 and s0_and_g are made
from those of train as always. After an interruption, run the script again: finished shards are
kept, and the rate is then no longer that of the whole. Memory is the largest peak resident set of a
process.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

from measuring import machine, run_command

from labyrinth_core.data.manifest import Manifest
from pipeline.inspection.statistics import count_dataset


def main() -> None:
    """Parse the options, build, certify and print; exit with 1 if a structure is in two splits."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data-dir", type=Path, required=True)
    parser.add_argument("--labyrinths", type=int, default=1_000_000)
    parser.add_argument("--random-steps", type=int, default=100, help="see the option")
    parser.add_argument("--workers", type=int, default=2)
    arguments = parser.parse_args()
    each = -(-arguments.labyrinths // 3)
    print(f"{machine()}; {each:,} labyrinths in each of train, validation and test", flush=True)
    cost = run_command(
        "stages=[build]",
        "size=5",
        f"labyrinths={each}",
        f"random_steps={arguments.random_steps}",
        f"data_dir={arguments.data_dir}",
        f"workers={arguments.workers}",
    )
    folder = arguments.data_dir / "5x5"
    manifest = Manifest.read(folder)
    rows, size = (sum(getattr(s, name) for s in manifest.shards) for name in ("rows", "bytes"))
    print(
        f"built: {rows:,} rows in {cost.seconds:,.0f} s, {rows / cost.seconds:,.0f} rows/s; ",
        end="",
    )
    print(f"peak memory {cost.memory} MiB; {size:,} bytes, {size / rows:.0f} a row", flush=True)
    begun = time.perf_counter()
    certificate = count_dataset(folder, manifest, arguments.workers).certificate
    for pair in certificate.pairs:
        mirrored = f"{len(pair.mirrored)} when mirror images count"
        print(f"{pair.first} and {pair.second} share {len(pair.equal)} structures, {mirrored}")
    problems = "; ".join(certificate.problems())
    verdict = problems or "no structure is where it may not be"
    print(f"certified in {time.perf_counter() - begun:,.0f} s: {verdict}")
    if problems:
        raise SystemExit(1)


if __name__ == "__main__":
    main()

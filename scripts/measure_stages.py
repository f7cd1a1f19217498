"""Measure stages and methods on 10,000 labyrinths of 5x5 and 300 of 25x25: seconds and memory.

    python scripts/measure_stages.py --folder FOLDER --log FILE
    python scripts/measure_stages.py --folder FOLDER --log FILE --size 25 --only export

Each runs in a process of its own, with one thread: first the build, then all that needs it. The log
gets a line for each, with the CPU seconds of its processes and the peak memory of the largest, by
`getrusage`; what is in the log is not measured again. Methods learn for one epoch from vectors, and
the others from the pictures of fewer labyrinths.
"""

from __future__ import annotations

import argparse
import shlex
from collections.abc import Iterator
from pathlib import Path

from measuring import machine, run_command

LABYRINTHS = {5: 10_000, 25: 300}
"""Size -> labyrinths in each split."""

VECTORS = "method.epochs=1 method.evaluate_every=1 encoder=mlp observation=vector"
METHODS = {
    **dict.fromkeys(("bc", "dagger", "sqil", "gail"), VECTORS),
    **dict.fromkeys(("bco", "iupe"), f"{VECTORS} train_labyrinths={{tenth}}"),
    "planner": "method.epochs=1 method.pictures=256 method.evaluate_every=1",
    "mapper": "method.epochs=1 train_labyrinths={tenth}",
}
"""Method -> its options; `tenth` is a tenth of the labyrinths."""


def commands(size: int, folder: Path) -> Iterator[tuple[str, str]]:
    """Yield a name and the options of each command, in the order in which they need one another."""
    count = LABYRINTHS[size]
    own = f"size={size} labyrinths={count} data_dir={folder}/data workers=1"
    runs = f"run_dir={folder}/runs threads=1"
    for stage in ("build", "validate", "analyse", "card", "questions"):
        yield stage, f"{own} stages={stage}"
    release = "publish.repo_id=user/labyrinth publish.version=1.0.0 publish.dry_run=true"
    yield "publish", f"{own} stages=publish {release}"
    for form in ("minari", "imitation", "lerobot"):
        yield f"export={form}", f"{own} stages=export export={form} export.folder={folder}/exports"
    yield "certify", f"{own} stages=certify certify.source={folder}/data/{size}x{size}"
    for method, given in METHODS.items():
        options = given.format(tenth=count // 10)
        yield f"train {method}", f"{own} {runs} stages=train method={method} {options}"
    yield "evaluate", f"{own} {runs} stages=evaluate method=bc {VECTORS}"
    yield "results", f"{own} {runs} stages=results results_dir={folder}/results"
    yield "report", f"{own} {runs} stages=report"
    season = f"season.name=2026-a season.folder={folder}/seasons"
    hidden = f"size={size} labyrinths={count} workers=1 {season}"
    yield "season", f"{hidden} stages=season season.date=2026-11-30"
    submission = f"season.submission={folder}/runs/{size}x{size}/bc-mlp-seed0"
    yield "judge", f"{season} stages=judge {submission} threads=1"
    yield "reveal", f"{season} stages=reveal"


def main() -> None:
    """Measure what the log lacks, and print its lines."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--folder", type=Path, required=True, help="for datasets and runs, kept")
    parser.add_argument("--log", type=Path, required=True, help="file that gets the lines")
    parser.add_argument("--size", type=int, nargs="*", choices=LABYRINTHS, default=[*LABYRINTHS])
    parser.add_argument("--only", nargs="*", default=[""], help="the commands whose name has this")
    given = parser.parse_args()
    print(machine("numpy", "pyarrow", "torch"), flush=True)
    known = given.log.read_text() if given.log.exists() else ""
    for size in given.size:
        for name, options in commands(size, given.folder.resolve() / str(size)):
            begins = f"{LABYRINTHS[size]} of {size}x{size} | {name} |"
            if begins not in known and any(part in name for part in given.only):
                try:
                    cost = run_command(*shlex.split(options))
                except SystemExit as refused:  # Such as questions on many shortest routes.
                    print(refused, flush=True)
                    continue
                with given.log.open("a") as log:
                    log.write(f"{begins} {cost.cpu:.1f} s | {cost.memory} MiB | {options}\n")
    print(given.log.read_text(), end="")


if __name__ == "__main__":
    main()

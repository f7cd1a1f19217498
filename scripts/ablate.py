"""What each ingredient of the planner is worth, and how many labyrinths it needs.

    python scripts/ablate.py ingredients --sizes 3 4 5 --seeds 0 1 2
    python scripts/ablate.py samples --sizes 5 --seeds 0 1 2

Trains one run a variant, size and seed, and tries it with scripts/generalise.py; all is kept under
`--folder`, so that a call goes on where another was stopped. Then it prints success rates with 95%
bootstrap intervals over seeds and labyrinths. Training sets of few labyrinths are the beginnings of
those of many; all are tried on the same 100 of a dataset of its own.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from pathlib import Path

import numpy as np

from pipeline.bootstrap import interval

INGREDIENTS = ("augment", "relabel", "average", "path_prior", "grid_prior", "colour_prior")
WITHOUT_GRID = "method.iterations=64"
"""Finer positions make longer ways."""

VARIANTS: dict[str, list[str]] = {
    "planner": ["method=planner"],
    **{f"without {name}": ["method=planner", f"method.{name}=false"] for name in INGREDIENTS},
    "without colour and grid": [
        "method=planner",
        "method.colour_prior=false",
        "method.grid_prior=false",
        WITHOUT_GRID,
    ],
    "bc": ["method=bc"],
    # As many gradient steps, of as many pictures each, as the planner takes.
    "bc with ingredients": [
        "method=bc",
        *(f"method.{name}=true" for name in ("augment", "relabel", "average")),
        "method.epochs=30",
        "method.batch_size=32",
    ],
}
VARIANTS["without grid_prior"].append(WITHOUT_GRID)
SAMPLES = (10, 25, 50, 100, 1_000, 10_000)


def main() -> None:
    """Run what is missing, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("study", choices=("ingredients", "samples"))
    parser.add_argument("--sizes", type=int, nargs="+", default=[5])
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2])
    parser.add_argument("--labyrinths", type=int, nargs="+", default=list(SAMPLES))
    parser.add_argument("--variants", nargs="+", choices=list(VARIANTS), default=None)
    parser.add_argument("--folder", type=Path, default=Path("runs/ablation"))
    given = parser.parse_args()
    chosen = given.variants or list(VARIANTS if given.study == "ingredients" else ["planner", "bc"])
    counts = given.labyrinths if given.study == "samples" else [None]
    for size in given.sizes:
        for count in counts:
            for name in chosen:
                found = [solved_by(given.folder, name, size, count, seed) for seed in given.seeds]
                report(f"{size}x{size} {name}" + (f", {count} labyrinths" if count else ""), found)


def solved_by(
    folder: Path, name: str, size: int, count: int | None, seed: int
) -> dict[str, list[bool]]:
    """Return which labyrinths a run solves, by set; train and try it unless that was done."""
    data = folder / "data" / (f"of-{count}" if count else "published")
    runs = folder / name.replace(" ", "-") / data.name
    kept = runs / f"{size}x{size}-seed{seed}.json"
    if not kept.exists():
        common = [f"size={size}", f"data_dir={data}"] + ([f"labyrinths={count}"] if count else [])
        options = [*VARIANTS[name], f"run_dir={runs}", f"seed={seed}", "threads=1"]
        published = f"data_dir={folder}/data/published"
        python = [sys.executable]
        run([*python, "run.py", f"size={size}", published, "stages=[build]"])
        run([*python, "run.py", *common, "stages=[build]"])
        # The dataset has the seed 0, whatever that of the run is.
        run([*python, "run.py", f"size={size}", f"data_dir={data}", *options, "stages=[train]"])
        method = VARIANTS[name][0].partition("=")[2]
        run_name = f"{method}-cnn-seed{seed}" if method == "bc" else f"{method}-seed{seed}"
        made = [str(runs / f"{size}x{size}" / run_name), "--data-dir", f"{folder}/data/published"]
        run([*python, "scripts/generalise.py", *made, "--json", str(kept)])
    solved: dict[str, list[bool]] = json.loads(kept.read_text())
    return solved


def run(command: list[str]) -> None:
    """Run a command; what it prints is kept back unless it fails."""
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode:
        raise SystemExit(f"{' '.join(command)}\n{done.stdout}{done.stderr}")


def report(name: str, found: list[dict[str, list[bool]]]) -> None:
    """Print a line of success rates over seeds."""
    cells = []
    for which in found[0]:
        values = np.array([each[which] for each in found], float)
        low, high = interval(values)
        cells.append(f"{which} {values.mean():.1%} [{100 * low:.0f}-{100 * high:.0f}]")
    print(f"{name:40} " + "  ".join(cells), flush=True)


if __name__ == "__main__":
    main()

r"""Hold the paper's tables against runs of `protocol=authors` and usual runs, cell by cell.

    python scripts/studies/report_authors.py --data-dir data/labyrinth \
        > docs/results/authors/table.md

Prints Markdown: what a uniformly random policy reaches by the rules of the authors' trial, and for
each cell of Tables 3 to 5 of which there is a run: as printed, by `protocol=authors` as their code
tries a policy, and as usual (the mean over seeds). A figure fits a printed one if the 95% interval
of their difference holds 0 (Agresti and Caffo 2000), each counted as of one seed.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from math import sqrt
from pathlib import Path

import numpy as np

from labyrinth_core.evaluation.labyrinth_arrays import load_arrays
from labyrinth_core.evaluation.results import Results
from labyrinth_core.evaluation.scores import EVALUATED_SPLITS, summary_of
from pipeline.config.training import usual_settings
from pipeline.machinery.markdown import table
from pipeline.studies.methods.authors.trial import try_out
from pipeline.studies.results.figures import Figures, run_of, summarise
from pipeline.studies.results.kept import read_runs
from pipeline.studies.results.paper import METHODS, PaperFigure, paper_figures

EPISODES = 50
"""Episodes of the random policy in each labyrinth."""


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--results", type=Path, default=Path("docs/results"))
    parser.add_argument("--data-dir", type=Path, required=True)
    given = parser.parse_args()
    runs = [
        each for each in read_runs(given.results / "authors") if run_of(each).protocol == "authors"
    ]
    usual = {
        (each.config, each.split, each.method): each
        for each in summarise(read_runs(given.results))
        if each.setup == "cnn"
    }
    configs = sorted({config for config, _, _ in paper_figures()})
    print("# Runs by the authors' protocol\n\n## Uniformly random actions, as SQIL is tried\n")
    print(table(["split", *headings(configs)], list(random_rows(given.data_dir, configs))))
    print("\n## The runs\n")
    heading = ["run", "differs from the script", "kept"]
    print(table(heading, [about(each) for each in runs], "lll"))
    for config in sorted({each.config for each in runs}):
        print(f"\n## {config}, labyrinths solved in percent\n")
        heading = ["method", "split", "printed", "authors", "usual", "what fits"]
        rows = [row for each in runs if each.config == config for row in cells(each, usual)]
        print(table(heading, rows, "llrrrl"))


def headings(configs: list[str]) -> list[str]:
    """Return the headings of the columns of the random policy."""
    return [f"{config}, {what}" for config in configs for what in ("random", "SQIL printed")]


def random_rows(data_dir: Path, configs: list[str]) -> list[list[str]]:
    """Return a row for each split: the random policy, and the paper's SQIL, for each config."""
    rows = [[split] for split in EVALUATED_SPLITS]
    for config in configs:
        for row in rows:
            arrays = load_arrays(data_dir, config, row[0], observation="vector")
            uniform, rng = np.full((len(arrays.terminal), 4), 0.25), np.random.default_rng(0)
            tried = (try_out(arrays, uniform, rng)[0] for _ in range(EPISODES))
            rate = np.mean([summary_of(each, arrays)["sr"] for each in tried])
            printed = paper_figures()[config, row[0], "sqil"]
            row += [f"{100 * rate:.1f}", f"{100 * printed.sr:.0f}"]
    return rows


def about(results: Results) -> list[str]:
    """Return which run it is, in what it differs from the script, and which epoch was kept."""
    run = run_of(results)
    chosen, script = run.settings, usual_settings(run.method, "authors")
    changed = (f"{name} {value:,}" for name, value in chosen.items() if value != script[name])
    kept = run.training["selected"]["epoch"]
    return [
        f"{METHODS[run.method]}, {results.config}, seed {run.seed}",
        ", ".join(changed),
        f"epoch {kept}",
    ]


def cells(results: Results, usual: Mapping[tuple[str, str, str], Figures]) -> list[list[str]]:
    """Return a row for each cell of the paper that a run is of."""
    rows, run = [], run_of(results)
    assert run.as_tried is not None
    for split in EVALUATED_SPLITS:
        key = results.config, split, run.method
        printed = paper_figures()[key]
        theirs = run.as_tried[split]["sr"]
        count = len(results.splits[split].distance)
        ours = usual[key].sr
        found = {"authors": fits(printed, theirs, count), "usual": fits(printed, ours, count)}
        rows.append(
            [
                METHODS[run.method],
                f"`{split}`",
                f"{100 * printed.sr:.0f}" + " †" * (not printed.is_possible),
                f"{100 * theirs:.0f}",
                f"{100 * ours:.0f}",
                " and ".join(name for name, holds in found.items() if holds) or "neither",
            ]
        )
    return rows


def fits(printed: PaperFigure, rate: float, count: int) -> bool:
    """Return whether two rates, each of `count` labyrinths, differ by no more than chance."""
    ours, theirs = ((each * count + 1) / (count + 2) for each in (rate, printed.sr))
    spread = sqrt((ours * (1 - ours) + theirs * (1 - theirs)) / (count + 2))
    return abs(ours - theirs) <= 1.96 * spread


if __name__ == "__main__":
    main()

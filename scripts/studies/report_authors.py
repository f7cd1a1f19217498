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
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from importlib import import_module
from math import sqrt
from pathlib import Path

import numpy as np
from kept_results import RESULTS, Run, by_method, rate, read_runs, solved_in, whole
from methods.authors.learner import try_out
from run_queue import AUTHORS

from labyrinth_core import load_arrays
from labyrinth_core.data import SPLITS
from labyrinth_core.evaluation.scores import Scores
from pipeline.machinery import table
from pipeline.results.leaderboard import IN_PRINT
from pipeline.results.tables import PaperFigure, paper_figures

Rates = Mapping[tuple[str, str], float]
"""Split and method -> the success rate of usual runs, the mean over seeds."""

VERDICTS = ("reproduced", "explained", "impossible", "open", "not run")
"""Ours is within chance of the paper's; a run of the authors' protocol is; it cannot be; none; or
none, and the authors' protocol was not run."""

Judged = tuple[float, float | None, float, str]
"""The rate printed, by the authors' protocol (None if it was not run), ours, and the verdict."""

EPISODES = 50
"""Episodes of the random policy in each labyrinth."""


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data-dir", type=Path, required=True)
    given = parser.parse_args()
    configs = sorted({config for config, _, _ in paper_figures()})
    print("# Runs by the authors' protocol\n\n## Uniformly random actions, as SQIL is tried\n")
    columns = (f"{config}, {what}" for config in configs for what in ("random", "SQIL printed"))
    print(table(["split", *columns], random_rows(given.data_dir, configs)))
    print("\n## The runs\n")
    found = {config: runs_of(config) for config in sizes_of()}
    rows = [about(each) for runs in found.values() for each in runs]
    print(table(["run", "differs from the script", "kept"], rows, "lll"))
    for config, runs in found.items():
        print(f"\n## {config}, labyrinths solved in percent\n")
        usual = usual_rates(config)
        heading = ["method", "seed", "split", "printed", "authors", "usual", "what fits"]
        print(table(heading, [row for each in runs for row in cells(each, usual)], "lrlrrrl"))


def sizes_of() -> list[str]:
    """Return the sizes of which there are runs by the authors' protocol."""
    return sorted(each.name for each in (RESULTS / "authors/runs").iterdir())


def runs_of(config: str) -> list[Run]:
    """Return the runs by the authors' protocol, in the usual order of methods."""
    groups = by_method(read_runs(f"authors/runs/{config}"))
    return [each for group in groups.values() for each in group]


def usual_rates(config: str) -> Rates:
    """Return the success rates of the usual runs of a size."""
    groups = by_method(read_runs(f"runs/{config}", "*-cnn-seed?.json")).values()
    return {
        (split, group[0]["run"]["method"]): float(solved_in(group, split).mean())
        for group in groups
        for split in SPLITS.evaluated
    }


def beside() -> str:
    """Return a table of all runs: printed, by the authors' protocol, and as usual."""
    rows = []
    for config in sizes_of():
        usual = usual_rates(config)
        for group in by_method(runs_of(config)).values():
            runs = [each["run"] for each in group]
            method, epochs = runs[0]["method"], runs[0]["settings"]["epochs"]
            found = []
            for split in SPLITS.evaluated:
                theirs = ", ".join(whole(each["as_tried"][split]["sr"]) for each in runs)
                figure = paper_figures()[config, split, method]
                found.append(f"{printed_in(figure)} / {theirs} / {whole(usual[split, method])}")
            rows.append([f"{config}, {IN_PRINT[method]}, {epochs} epochs", *found])
    heading = "% solved: printed / authors' protocol, each seed / ours"
    return table([heading, *(f"`{split}`" for split in SPLITS.evaluated)], rows)


def verdicts() -> str:
    """Return a table of every cell of the paper: printed, theirs by our hand, ours, the verdict."""
    rows = []
    for (config, method), judged in judged_cells().items():
        found = []
        for printed, theirs, ours, verdict in judged:
            tried = "-" if theirs is None else whole(theirs)
            if verdict == "not run":
                verdict += f": {AUTHORS[config][method][1]} hours"
            found.append(f"{whole(printed)} / {tried} / {whole(ours)}, {verdict}")
        rows.append([f"{config}, {IN_PRINT[method]}", *found])
    heading = "% solved: printed / authors' protocol / ours"
    return table([heading, *(f"`{split}`" for split in SPLITS.evaluated)], rows, "l" * 6)


def resnet() -> str:
    """Return a table of the paper's cells beside our runs with ResNet-18, each with a verdict."""
    rows = []
    for config in sorted({config for config, _, _ in paper_figures()}):
        groups = by_method(read_runs(f"runs/{config}", "*-resnet18-seed?.json")).values()
        for runs in groups:
            method, epochs = runs[0]["run"]["method"], runs[0]["run"]["training"]["epochs"]
            cells = (
                _judged_in(runs, paper_figures()[config, split, method])
                for split in SPLITS.evaluated
            )
            rows.append([f"{config}, {IN_PRINT[method]}", str(len(runs)), str(epochs), *cells])
    heading = ["% solved: printed / ResNet-18 here", "seeds", "epochs"]
    return table([*heading, *(f"`{split}`" for split in SPLITS.evaluated)], rows, "lrr" + "l" * 5)


def _judged_in(runs: Sequence[Run], figure: PaperFigure) -> str:
    solved = solved_in(runs, figure.split)
    ours = float(solved.mean())
    return f"{whole(figure.sr)} / {rate(solved)}, {judge(figure, ours, ours)[-1]}"


def counted_verdicts() -> str:
    """Return a table of the number of cells with each verdict, by size."""
    found: dict[str, Counter[str]] = {}
    for (config, _), judged in judged_cells().items():
        found.setdefault(config, Counter()).update(verdict for *_, verdict in judged)
    found["all"] = sum(found.values(), Counter())
    rows = [[config, *(str(counts[each]) for each in VERDICTS)] for config, counts in found.items()]
    return table(["cells", *VERDICTS], rows)


def judged_cells() -> dict[tuple[str, str], list[Judged]]:
    """Return the cells of the paper by config and method, one a split."""
    found = {}
    for config in sorted({config for config, _, _ in paper_figures()}):
        usual = usual_rates(config)
        tried = runs_of(config) if config in sizes_of() else []
        for method in IN_PRINT:
            runs = [each["run"] for each in tried if each["run"]["method"] == method]
            found[config, method] = [
                judge(
                    paper_figures()[config, split, method],
                    usual[split, method],
                    np.mean([each["as_tried"][split]["sr"] for each in runs]) if runs else None,
                )
                for split in SPLITS.evaluated
            ]
    return found


def judge(figure: PaperFigure, ours: float, theirs: float | None) -> Judged:
    """Return a cell of the paper with what it is: a word of `VERDICTS`."""
    count = 32 if figure.size == 3 else 100  # The labyrinths of a split in the paper.
    if not figure.is_possible:
        verdict = "impossible"
    elif fits(figure, ours, count):
        verdict = "reproduced"
    elif theirs is not None and fits(figure, theirs, count):
        verdict = "explained"
    else:
        verdict = "not run" if theirs is None else "open"
    return figure.sr, theirs, ours, verdict


def printed_in(figure: PaperFigure, mark: str = "†") -> str:
    """Return a cell of the paper, marked if it is impossible."""
    return whole(figure.sr) + mark * (not figure.is_possible)


def random_rows(data_dir: Path, configs: list[str]) -> list[list[str]]:
    """Return a row for each split: the random policy, and the paper's SQIL, for each config."""
    rows = [[split] for split in SPLITS.evaluated]
    for config in configs:
        for row in rows:
            arrays = load_arrays(data_dir, config, row[0], observation="vector")
            uniform, rng = np.full((len(arrays.terminal), 4), 0.25), np.random.default_rng(0)
            tried = (try_out(arrays, uniform, rng)[0] for _ in range(EPISODES))
            rate = np.mean([Scores.of(each, arrays).sr for each in tried])
            printed = paper_figures()[config, row[0], "sqil"]
            row += [f"{100 * rate:.1f}", f"{100 * printed.sr:.0f}"]
    return rows


def about(kept: Run) -> list[str]:
    """Return which run it is, in what it differs from the script, and which epoch was kept."""
    run = kept["run"]
    method = import_module(f"methods.authors.{run['method']}")
    chosen, script = run["settings"], asdict(method.Settings())
    changed = (f"{name} {value:,}" for name, value in chosen.items() if value != script[name])
    epoch = run["training"]["selected"]["epoch"]
    return [
        f"{IN_PRINT[run['method']]}, {run['config']}, seed {run['seed']}",
        ", ".join(changed),
        f"epoch {epoch}",
    ]


def cells(kept: Run, usual: Rates) -> list[list[str]]:
    """Return a row for each cell of the paper that a run is of."""
    rows, run = [], kept["run"]
    for split in SPLITS.evaluated:
        printed = paper_figures()[run["config"], split, run["method"]]
        theirs, ours = run["as_tried"][split]["sr"], usual[split, run["method"]]
        count = len(kept["solved"][split])
        found = {"authors": fits(printed, theirs, count), "usual": fits(printed, ours, count)}
        rows.append(
            [
                IN_PRINT[run["method"]],
                str(run["seed"]),
                f"`{split}`",
                printed_in(printed, " †"),
                *map(whole, (theirs, ours)),
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

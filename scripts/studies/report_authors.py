"""Hold the paper's tables against runs of `protocol=authors` and usual runs, cell by cell.

For each cell of Tables 3 to 5: as printed, by `protocol=authors` as their code tries a policy, and
as usual (the mean over seeds). A figure fits a printed one if the 95% interval of their difference
holds 0 (Agresti and Caffo 2000), each counted as of one seed. `report_pages.py` writes them.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from math import sqrt

import numpy as np
from kept_results import RESULTS, Run, by_method, read_runs, solved_in, whole

from labyrinth_core.evaluation.scores import EVALUATED_SPLITS
from pipeline.machinery.markdown import table
from pipeline.studies.results.paper import METHODS, PaperFigure, paper_figures

Rates = Mapping[tuple[str, str], float]
"""Split and method -> the success rate of usual runs, the mean over seeds."""

VERDICTS = ("reproduced", "explained", "impossible", "open")
"""Ours is within chance of the paper's; a run of the authors' protocol is; it cannot be; none."""

Judged = tuple[float, float | None, float, str]
"""The rate printed, by the authors' protocol (None if it was not run), ours, and the verdict."""


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
        for split in EVALUATED_SPLITS
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
            for split in EVALUATED_SPLITS:
                theirs = ", ".join(whole(each["as_tried"][split]["sr"]) for each in runs)
                figure = paper_figures()[config, split, method]
                found.append(f"{printed_in(figure)} / {theirs} / {whole(usual[split, method])}")
            rows.append([f"{config}, {METHODS[method]}, {epochs} epochs", *found])
    heading = "% solved: printed / authors' protocol, each seed / ours"
    return table([heading, *(f"`{split}`" for split in EVALUATED_SPLITS)], rows)


def verdicts() -> str:
    """Return a table of every cell of the paper: printed, theirs by our hand, ours, the verdict."""
    rows = []
    for (config, method), judged in judged_cells().items():
        found = []
        for printed, theirs, ours, verdict in judged:
            tried = "-" if theirs is None else whole(theirs)
            found.append(f"{whole(printed)} / {tried} / {whole(ours)}, {verdict}")
        rows.append([f"{config}, {METHODS[method]}", *found])
    heading = "% solved: printed / authors' protocol / ours"
    return table([heading, *(f"`{split}`" for split in EVALUATED_SPLITS)], rows, "l" * 6)


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
        for method in METHODS:
            runs = [each["run"] for each in tried if each["run"]["method"] == method]
            found[config, method] = [
                judge(
                    paper_figures()[config, split, method],
                    usual[split, method],
                    np.mean([each["as_tried"][split]["sr"] for each in runs]) if runs else None,
                )
                for split in EVALUATED_SPLITS
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
        verdict = "open"
    return figure.sr, theirs, ours, verdict


def printed_in(figure: PaperFigure) -> str:
    """Return a cell of the paper, marked if it is impossible."""
    return whole(figure.sr) + "†" * (not figure.is_possible)


def fits(printed: PaperFigure, rate: float, count: int) -> bool:
    """Return whether two rates, each of `count` labyrinths, differ by no more than chance."""
    ours, theirs = ((each * count + 1) / (count + 2) for each in (rate, printed.sr))
    spread = sqrt((ours * (1 - ours) + theirs * (1 - theirs)) / (count + 2))
    return abs(ours - theirs) <= 1.96 * spread

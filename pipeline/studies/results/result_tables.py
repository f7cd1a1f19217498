"""The tables of the stage `results`, as Markdown, CSV and LaTeX, beside the paper's figures."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict
from itertools import groupby
from operator import attrgetter
from pathlib import Path
from statistics import mean

from labyrinth_core.data.storage import write_text
from labyrinth_core.evaluation.baselines import BASELINES
from labyrinth_core.evaluation.references import REFERENCES
from labyrinth_core.evaluation.replanner import REPLANNERS
from labyrinth_core.evaluation.scores import EVALUATED_SPLITS
from pipeline.machinery.markdown import plain, table
from pipeline.studies.results import spreadsheet
from pipeline.studies.results.evaluations import (
    AVERAGED,
    BY_METHOD,
    FAILURES,
    Evaluation,
    Figures,
    gap,
)
from pipeline.studies.results.leaderboard import Standing
from pipeline.studies.results.paper import METHODS, PaperFigure, name_of, paper_figures
from pipeline.studies.results.ranking import across_sizes, pairs_of_methods

MARK = "†"
"""Marks a figure of the paper that is impossible given its AER and SR."""

WITHOUT_LEARNING = (*BASELINES, *REFERENCES, *REPLANNERS)
"""What needs no learning, in the order of its columns."""
SHARES = {"SR": "sr", "SR n x n": "sr_within_cells", "SPL": "spl"}
"""Row -> the figure of what needs no learning that it shows, in percent."""

ABOUT = f"""# Results

One greedy episode for every labyrinth. SR: share of the labyrinths that were solved, in percent.
AER: average episodic return, ± its standard deviation over labyrinths; an episode that fails
returns -4. SR n x n: share that was solved in no more steps than there are cells. SPL: success
weighted by path length. A route is known where train demonstrates an optimal route of the
labyrinth, else it is new. A dash, or nothing: an older file does not say. Figures of several seeds
are means; in brackets, 95% bootstrap intervals over seeds and labyrinths. `paper`: Tables 3 to 5 of
the supplement, which do not say with which encoder; {MARK} marks cells that cannot be, since even
the shortest routes would return less than AER and SR imply.

The runs themselves are in `runs/`, all of this as numbers is in `results.csv`, and as LaTeX in
`results.tex`. Ranked, and beside anybody's results, they are in `leaderboard.md`.
`labyrinth-datasets stages=[results]` makes these files.
"""


def write_tables(
    folder: Path, evaluations: Sequence[Evaluation], figures: Sequence[Figures]
) -> None:
    """Write `README.md`, `results.csv` and `results.tex` into a folder."""
    key = attrgetter("config", "setup")
    parts, tex = [ABOUT], []
    for (config, setup), grouped in groupby(figures, key):
        group = list(grouped)
        runs = [each for each in evaluations if key(each) == (config, setup)]
        parts += [
            f"## {plain(f'{config}, {setup}')}\n",
            *(part + "\n" for part in markdown(group, runs)),
        ]
        tex.append(latex(group))
    parts += across_sizes(evaluations)
    write_text(folder / "README.md", "\n".join(parts))
    write_text(folder / "results.csv", as_csv(figures))
    write_text(folder / "results.tex", "\n".join(tex))


def markdown(group: Sequence[Figures], runs: Sequence[Evaluation]) -> Iterator[str]:
    """Yield the tables of one config and setup."""
    methods = methods_of(group)
    names = [name_of(method) for method in methods]
    yield table(["split", "", "", *names], compared(group, methods), "lll" + "r" * len(names))
    yield from pairs_of_methods(runs)
    yield "What needs no learning:"
    without = [name for name in WITHOUT_LEARNING if name in runs[0].content["baselines"]["train"]]
    heading = ["split", "", *(name.replace("_", " ") for name in without)]
    yield table(heading, _baseline_rows(runs[0], without), "ll" + "r" * len(without))
    yield "Where an episode ends, and how good the actions are in all states, in percent:"
    heading = ["method", "split", "solved", *FAILURES, "solved within n x n", "SPL"]
    heading += ["solved, known route", "new route", "path efficiency"]
    heading += ["optimal actions on demonstrations", "elsewhere"]
    yield table(heading, map(_detail, group), "ll" + "r" * (len(heading) - 2))
    yield "By moves on a shortest route, episodes that succeed, of all:"
    lengths = sorted({moves for each in group for moves in each.by_distance})
    rows = [
        [name_of(each.method), each.split] + [each.by_distance.get(moves, "") for moves in lengths]
        for each in group
    ]
    yield table(["method", "split", *map(str, lengths)], rows, "ll" + "r" * len(lengths))
    yield "SR on train less that on test, in points, and what the runs took:"
    heading = ["method", "seeds", "gap", "epochs", "epoch selected", "minutes", "device"]
    by_method = (list(group) for _, group in groupby(runs, BY_METHOD))
    yield table(heading, map(_effort, by_method), "lrrrrrl")


def methods_of(group: Sequence[Figures]) -> list[str]:
    """Return the methods of a table's columns: the paper's if it has this config, then ours."""
    in_paper = [name for config, _, name in paper_figures() if config == group[0].config]
    return list(dict.fromkeys([*in_paper, *(each.method for each in group)]))


def compared(group: Sequence[Figures], methods: Sequence[str]) -> Iterator[list[str]]:
    """Yield the rows of a comparison: for each split SR and AER, of the paper and ours."""
    here = {(each.split, each.method): each for each in group}
    paper = paper_figures()
    for split in EVALUATED_SPLITS:
        printed = [_printed(paper.get((group[0].config, split, method))) for method in methods]
        measured = [_measured(here.get((split, method))) for method in methods]
        for index, name in enumerate(("SR", "AER")):
            if any(sr for sr, _ in printed):
                yield [split, name, "paper", *(each[index] for each in printed)]
            yield [split, name, "here", *(each[index] for each in measured)]


def _printed(figure: PaperFigure | None) -> tuple[str, str]:
    """Return SR and AER as the paper prints them, marked if they are impossible."""
    if figure is None:
        return "", ""
    mark = "" if figure.is_possible else " " + MARK
    return f"{100 * figure.sr:.1f}{mark}", f"{figure.aer:.2f} ± {figure.aer_std:.2f}{mark}"


def _measured(figures: Figures | None) -> tuple[str, str]:
    """Return our SR and AER with their intervals."""
    return ("", "") if figures is None else (sr_cell(figures), aer_cell(figures))


def sr_cell(figures: Figures | Standing) -> str:
    """Return SR in percent with its interval."""
    low, high = figures.sr_interval
    return f"{100 * figures.sr:.1f} [{100 * low:.1f}, {100 * high:.1f}]"


def aer_cell(figures: Figures | Standing) -> str:
    """Return AER, its standard deviation and its interval."""
    low, high = figures.aer_interval
    return f"{figures.aer:.2f} ± {figures.aer_std:.2f} [{low:.2f}, {high:.2f}]"


def _baseline_rows(evaluation: Evaluation, names: Sequence[str]) -> Iterator[list[str]]:
    for split in EVALUATED_SPLITS:
        told = [evaluation.content["baselines"][split].get(name, {}) for name in names]
        for heading, figure in SHARES.items():
            cells = (f"{100 * each[figure]:.1f}" if figure in each else "-" for each in told)
            yield [split, heading, *cells]
        pairs = (f"{each['aer']:.2f} ± {each['aer_std']:.2f}" if each else "-" for each in told)
        yield [split, "AER", *pairs]


def _detail(each: Figures) -> list[str]:
    shares = (each.sr, *each.failures.values(), *each.averages.values())
    cells = ("" if share is None else f"{100 * share:.1f}" for share in shares)
    return [name_of(each.method), each.split, *cells]


def _effort(runs: Sequence[Evaluation]) -> list[str]:
    """Return a method's gap between train and test, and the effort of its runs."""
    told = [each.content["training"] for each in runs]
    points, low, high = (100 * share for share in gap(runs))
    return [
        name_of(runs[0].method),
        str(len(runs)),
        f"{points:.1f} [{low:.1f}, {high:.1f}]",
        _listed(each["epochs"] for each in told),
        _listed(each["selected"]["epoch"] for each in told),
        f"{mean(each['seconds'] for each in told) / 60:.1f}",
        plain(_listed(each["computed"]["device"] for each in told)),
    ]


def _listed(values: Iterable[object]) -> str:
    return ", ".join(dict.fromkeys(map(str, values)))


def as_csv(figures: Sequence[Figures]) -> str:
    """Return all figures, the paper's and ours, one row each; shares, not percent."""
    rows: list[dict[str, object]] = [
        asdict(each) | {"config": config, "source": "paper", "possible": each.is_possible}
        for (config, _, _), each in paper_figures().items()
    ]
    for figure in figures:
        row = asdict(figure) | figure.failures | figure.averages
        row |= {"source": "here", "possible": True}
        for name in ("sr", "aer"):
            row[f"{name}_low"], row[f"{name}_high"] = row.pop(f"{name}_interval")
        rows.append(row)
    columns = ["config", "setup", "method", "split", "source", "seeds"]
    columns += ["sr", "sr_low", "sr_high", "aer", "aer_std", "aer_low", "aer_high"]
    columns += [*AVERAGED, *FAILURES, "possible"]
    return spreadsheet.as_csv(columns, rows)


def latex(group: Sequence[Figures]) -> str:
    """Return the comparison of one config and setup as a LaTeX table (package booktabs)."""
    methods = methods_of(group)
    lines = [
        f"% {' '.join(f'{group[0].config}, {group[0].setup}'.split())}",
        rf"\begin{{tabular}}{{lll{'r' * len(methods)}}}",
        r"\toprule",
        _latex_row(["Split", "", "", *(METHODS.get(method, method) for method in methods)]),
        r"\midrule",
        *(_latex_row(row) for row in compared(group, methods)),
        r"\bottomrule",
        r"\end{tabular}",
    ]
    return "\n".join(lines) + "\n"


_LATEX = {
    **{letter: rf"\{letter}" for letter in "_&%$#{}"},
    **{"\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}"},
    **{"±": r"$\pm$", MARK: r"$^\dagger$", "-": "$-$"},
}
"""Letter -> what prints it."""


def _latex_row(cells: Sequence[str]) -> str:
    escaped = ("".join(_LATEX.get(letter, letter) for letter in cell) for cell in cells)
    return " & ".join(escaped) + r" \\"

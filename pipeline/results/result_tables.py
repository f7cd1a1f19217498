"""The tables of the stage `results`, as Markdown and CSV, with the paper's figures."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict
from itertools import groupby
from pathlib import Path
from statistics import mean

from labyrinth_core.evaluation.baselines import BASELINES, REFERENCES
from labyrinth_core.evaluation.replanner import REPLANNERS
from labyrinth_core.evaluation.results import Results
from labyrinth_core.evaluation.scores import EVALUATED_SPLITS, WHY_SPL
from pipeline.machinery.artifact import leave
from pipeline.machinery.markdown import plain, table
from pipeline.results import spreadsheet
from pipeline.results.comparison import across_sizes, pairs_of_methods, rates_of
from pipeline.results.figures import AVERAGED, FAILURES, Figures, MethodRuns, gap, run_of
from pipeline.results.paper import PaperFigure, name_of, paper_figures

MARK = "†"
"""Marks a cell of the paper whose AER and SR contradict each other."""

WITHOUT_LEARNING = (*BASELINES, *REFERENCES, *REPLANNERS)
"""Baselines that need no training, in the order of their columns."""

ABOUT = f"""# Results

{WHY_SPL}

SPL: moves on a shortest route divided by moves taken, 0 if unsolved, averaged. SR: share of solved
labyrinths. Both are in percent, with one greedy episode per labyrinth. Figures of several seeds are
means; in brackets, 95% bootstrap intervals over seeds and labyrinths. `SR in the paper`: Tables 3
to 5 of the supplement, which have no SPL and do not name the encoder; {MARK} marks impossible
cells, in which even the shortest routes would return less than the printed average return and SR
imply.

`results.csv` has the same figures, and returns (AER), SR within n x n steps, SR on known and on new
routes, path efficiency, accuracies, reasons for failure, and successes by the length of a shortest
route. The runs are in `runs/`; `leaderboard.md` ranks them beside submissions.
`labyrinth-datasets stages=results` makes these files.
"""


def write_tables(folder: Path, methods: Sequence[MethodRuns]) -> None:
    """Write `README.md` and `results.csv` into a folder; raise as `artifact.leave`."""
    parts = [ABOUT]
    for (config, setup), group in groupby(methods, lambda each: (each.config, each.setup)):
        parts.append(f"## {plain(f'{config}, {setup}')}\n")
        parts += [part + "\n" for part in markdown(list(group))]
    parts += across_sizes(methods)
    files = {"README.md": "\n".join(parts), "results.csv": as_csv(methods)}
    leave(folder, {name: text.encode() for name, text in files.items()})


def markdown(group: Sequence[MethodRuns]) -> Iterator[str]:
    """Yield the tables of one config and setup."""
    first, methods = group[0].runs[0], methods_of(group)
    names = [name_of(method) for method in methods]
    yield table(["split", "figure", *names], compared(group, methods), "ll" + "r" * len(names))
    *_, conclusion = ["", *pairs_of_methods(rates_of(group))]
    if conclusion:
        yield f"On test: {conclusion}"
    yield "SPL / SR of the references, which do not learn:"
    without = [name for name in WITHOUT_LEARNING if name in first.baselines]
    heading = ["split", *(name.replace("_", " ") for name in without)]
    yield table(heading, _baseline_rows(first, without))
    yield "Gap: SR on train minus SR on test, in points. Training of the runs:"
    heading = ["method", "seeds", "gap", "epochs", "epoch selected", "minutes", "device"]
    yield table(heading, map(_effort, group), "lrrrrrl")


def methods_of(group: Sequence[MethodRuns]) -> list[str]:
    """Return the methods of a table's columns: the paper's for this config, then our others."""
    in_paper = [name for config, _, name in paper_figures() if config == group[0].config]
    return list(dict.fromkeys([*in_paper, *(each.method for each in group)]))


def compared(group: Sequence[MethodRuns], methods: Sequence[str]) -> Iterator[list[str]]:
    """Yield the rows of a comparison: for each split our SPL and SR, and the SR in the paper."""
    here = {each.method: each.figures for each in group}
    paper = paper_figures()
    for split in EVALUATED_SPLITS:
        ours = [here[method][split] if method in here else None for method in methods]
        cells = {
            "SPL": [each and percent_cell(each.spl, each.spl_interval) for each in ours],
            "SR": [each and percent_cell(each.sr, each.sr_interval) for each in ours],
        }
        printed = [_printed(paper.get((group[0].config, split, method))) for method in methods]
        if any(printed):
            cells["SR in the paper"] = [*printed]
        for name, row in cells.items():
            yield [split, name, *(each or "" for each in row)]


def _printed(figure: PaperFigure | None) -> str:
    """Return the paper's SR in percent, marked if it is impossible."""
    mark = "" if figure is None or figure.is_possible else " " + MARK
    return "" if figure is None else f"{100 * figure.sr:.1f}{mark}"


def percent_cell(share: float, bounds: tuple[float, float]) -> str:
    """Return a share in percent with its interval."""
    low, high = bounds
    return f"{100 * share:.1f} [{100 * low:.1f}, {100 * high:.1f}]"


def aer_cell(figures: Figures) -> str:
    """Return AER, its standard deviation and its interval."""
    low, high = figures.aer_interval
    return f"{figures.aer:.2f} ± {figures.aer_std:.2f} [{low:.2f}, {high:.2f}]"


def _baseline_rows(results: Results, names: Sequence[str]) -> Iterator[list[str]]:
    for split in EVALUATED_SPLITS:
        found = (results.baselines[name][split] for name in names)
        yield [split, *(f"{100 * each['spl']:.1f} / {100 * each['sr']:.1f}" for each in found)]


def _effort(method: MethodRuns) -> list[str]:
    """Return a row: a method's gap between train and test, and the cost of its runs."""
    training = [run_of(each).training for each in method.runs]
    points, low, high = (100 * share for share in gap(method.runs))
    return [
        name_of(method.method),
        str(len(method.runs)),
        f"{points:.1f} [{low:.1f}, {high:.1f}]",
        _listed(each["epochs"] for each in training),
        _listed(each["selected"]["epoch"] for each in training),
        f"{mean(each['seconds'] for each in training) / 60:.1f}",
        plain(_listed(each["computed"]["device"] for each in training)),
    ]


def _listed(values: Iterable[object]) -> str:
    return ", ".join(dict.fromkeys(map(str, values)))


def as_csv(methods: Sequence[MethodRuns]) -> str:
    """Return all figures as CSV, one row per method and split; shares, not percent.

    The paper's figures come first, then ours, then those of baselines without training, taken from
    the first run of each config and setup.
    """
    rows: list[dict[str, object]] = [
        asdict(each) | {"config": config, "source": "paper", "possible": each.is_possible}
        for (config, _, _), each in paper_figures().items()
    ]
    firsts: dict[tuple[str, str], Results] = {}
    for each in methods:
        firsts.setdefault((each.config, each.setup), each.runs[0])
        about = {"config": each.config, "setup": each.setup, "method": each.method}
        here = about | {"source": "here", "possible": True, "seeds": len(each.runs)}
        for split, figures in each.figures.items():
            rows.append(here | {"split": split} | figures.columns())
    for (config, setup), results in firsts.items():
        about = {"config": config, "setup": setup, "source": "no learning"}
        for name in WITHOUT_LEARNING:
            for split, found in results.baselines.get(name, {}).items():
                rows.append(about | {"method": name, "split": split} | dict(found))
    columns = ["config", "setup", "method", "split", "source", "seeds"]
    columns += ["spl", "spl_low", "spl_high", "sr_within_cells"]
    columns += ["sr", "sr_low", "sr_high", "aer", "aer_std", "aer_low", "aer_high"]
    columns += [*AVERAGED, *FAILURES, "possible", "by_distance"]
    return spreadsheet.as_csv(columns, rows)

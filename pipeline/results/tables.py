"""The files `README.md` and `results.csv`: all trained methods, with the paper's figures."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict
from itertools import groupby
from statistics import mean

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.data import SPLITS
from labyrinth_core.evaluation import Results
from pipeline.machinery import plain, table
from pipeline.results.comparison import conclusion, interquartile_mean
from pipeline.results.entry import (
    RANKED_BY,
    Entry,
    as_csv,
    percent_cell,
)
from pipeline.results.kept import run_of
from pipeline.results.paper import PaperFigure, name_of, paper_figures

MARK = "†"
"""Marks a cell of the paper whose AER and SR contradict each other."""

ABOUT = f"""# Results

{Results.WHY_SPL}

SPL: moves on a shortest route divided by moves taken, 0 if unsolved, averaged. SR: share of solved
labyrinths. Both are in percent, with one greedy episode per labyrinth. Figures of several seeds are
means; in brackets, 95% intervals over labyrinths, and over seeds if there are several. `SR in the
paper`: Tables 3 to 5 of the supplement, which have no SPL and do not name the encoder; {MARK} marks
impossible cells, in which even the shortest routes would return less than the printed average
return and SR imply.

`results.csv` has the same figures, and returns (AER), SR within n x n steps, SR on known and on new
routes, path efficiency, accuracies, reasons for failure, and successes by the length of a shortest
route. The runs are in `runs/`; `leaderboard.md` ranks them beside submissions.
`labyrinth-datasets stages=results` makes these files.
"""

COLUMNS = (
    *("config", "setup", "method", "split", "source", "seeds"),
    *("spl", "spl_low", "spl_high", "sr_within_cells"),
    *("sr", "sr_low", "sr_high", "aer", "aer_std", "aer_low", "aer_high"),
    *("sr_known_route", "sr_new_route", "path_efficiency"),
    *("accuracy_on_demonstrations", "accuracy_elsewhere"),
    *("loop", "wall", "ice", "possible", "by_distance"),
)
"""The columns of `results.csv`."""

ABOUT_SIZES = f"""\
Interquartile mean of SR on {RANKED_BY} over sizes and seeds: the lowest and the highest quarter of
the runs are left out. It has no interval, and does not rank methods.
"""


def tables(methods: Sequence[Entry]) -> dict[str, str]:
    """Return the text of `README.md` and of `results.csv`, by name; the entries are of runs."""
    parts = [ABOUT]
    for (config, setup), group in groupby(methods, lambda each: (each.config, each.run.setup)):
        parts.append(f"## {plain(f'{config}, {setup}')}\n")
        parts += [part + "\n" for part in markdown(list(group))]
    parts += across_sizes(methods)
    return {"README.md": "\n".join(parts), "results.csv": csv_of(methods)}


def markdown(group: Sequence[Entry]) -> Iterator[str]:
    """Yield the tables of one config and setup."""
    first, methods = group[0].results[0], methods_of(group)
    names = [name_of(method) for method in methods]
    yield table(["split", "figure", *names], compared(group, methods), "ll" + "r" * len(names))
    rates = {name_of(each.run.method): each.rates for each in group}
    if len(rates) > 1:
        yield f"On {RANKED_BY}: {conclusion(rates)}"
    yield "SPL / SR of the references, which do not learn:"
    without = [name for name in Results.WITHOUT_LEARNING if name in first.baselines]
    heading = ["split", *(name.replace("_", " ") for name in without)]
    yield table(heading, _baseline_rows(first, without))
    yield "Gap: SR on train minus SR on test, in points. Training of the runs:"
    heading = ["method", "seeds", "gap", "epochs", "epoch selected", "minutes", "device"]
    yield table(heading, map(_effort, group), "lrrrrrl")


def methods_of(group: Sequence[Entry]) -> list[str]:
    """Return the methods of a table's columns: the paper's for this config, then our others."""
    in_paper = [name for config, _, name in paper_figures() if config == group[0].config]
    return list(dict.fromkeys([*in_paper, *(each.run.method for each in group)]))


def compared(group: Sequence[Entry], methods: Sequence[str]) -> Iterator[list[str]]:
    """Yield the rows of a comparison: for each split our SPL and SR, and the SR in the paper."""
    here = {each.run.method: each.figures for each in group}
    paper = paper_figures()
    for split in SPLITS.evaluated:
        ours = [here[method][split] if method in here else None for method in methods]
        for name in ("spl", "sr"):
            cells = ("" if each is None else percent_cell(each, name) for each in ours)
            yield [split, name.upper(), *cells]
        printed = [_printed(paper.get((group[0].config, split, method))) for method in methods]
        if any(printed):
            yield [split, "SR in the paper", *printed]


def _printed(figure: PaperFigure | None) -> str:
    """Return the paper's SR in percent, marked if it is impossible."""
    mark = "" if figure is None or figure.is_possible else " " + MARK
    return "" if figure is None else f"{100 * figure.sr:.1f}{mark}"


def _baseline_rows(results: Results, names: Sequence[str]) -> Iterator[list[str]]:
    for split in SPLITS.evaluated:
        by_name = (results.baselines[name][split] for name in names)
        yield [split, *(f"{100 * each['spl']:.1f} / {100 * each['sr']:.1f}" for each in by_name)]


def _effort(method: Entry) -> list[str]:
    """Return a row: a method's gap between train and test, and the cost of its runs."""
    training = [run_of(each).training for each in method.results]
    points, low, high = (100 * share for share in Results.gap(method.results))
    return [
        name_of(method.run.method),
        str(len(training)),
        f"{points:.1f} [{low:.1f}, {high:.1f}]",
        _listed(each["epochs"] for each in training),
        _listed(each["selected"]["epoch"] for each in training),
        f"{mean(each['seconds'] for each in training) / 60:.1f}",
        plain(_listed(each["computed"]["device"] for each in training)),
    ]


def _listed(values: Iterable[object]) -> str:
    return ", ".join(dict.fromkeys(map(str, values)))


def across_sizes(methods: Sequence[Entry]) -> Iterator[str]:
    """Yield a table of interquartile means over sizes and seeds, for methods with several sizes."""
    groups: dict[tuple[str, str, str], dict[str, NDArray[np.float64]]] = {}
    for each in methods:
        size, _, task = each.config.partition("-")
        groups.setdefault((task, each.run.setup, each.run.method), {})[size] = each.rates
    rows = []
    for (task, setup, method), by_size in groups.items():
        if len(by_size) > 1:
            runs = np.concatenate([*by_size.values()])
            middle = f"{100 * interquartile_mean(runs):.1f}"
            name = plain(" ".join(part for part in (setup, task) if part))
            rows.append([name, name_of(method), ", ".join(by_size), str(len(runs)), middle])
    if rows:
        yield "## All sizes\n"
        yield ABOUT_SIZES
        yield table(["setup", "method", "sizes", "runs", "SR"], rows, "lllrr") + "\n"


def csv_of(methods: Sequence[Entry]) -> str:
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
        firsts.setdefault((each.config, each.run.setup), each.results[0])
        about = {"config": each.config, "setup": each.run.setup, "method": each.run.method}
        here = about | {"source": "here", "possible": True, "seeds": len(each.results)}
        rows += [here | {"split": split} | figures for split, figures in each.figures.items()]
    for (config, setup), results in firsts.items():
        about = {"config": config, "setup": setup, "source": "no learning"}
        for name in Results.WITHOUT_LEARNING:
            for split, figures in results.baselines.get(name, {}).items():
                rows.append(about | {"method": name, "split": split} | dict(figures))
    return as_csv(COLUMNS, rows)

"""The tables of the stage `results`, as Markdown, CSV and LaTeX, beside the paper's figures."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from statistics import mean

from labyrinth_core.data.storage import write_text
from labyrinth_core.evaluation.baselines import BASELINES
from labyrinth_core.evaluation.scores import EVALUATED_SPLITS
from pipeline.machinery.markdown import table
from pipeline.training.results.evaluations import Evaluation, Figures, gap
from pipeline.training.results.paper import METHODS, PaperFigure, paper_figures

MARK = "†"
"""Beside a figure of the paper that its own AER and SR contradict."""

ABOUT = f"""# Results

One greedy episode for every labyrinth. SR: share of the labyrinths that were solved, in percent.
AER: average episodic return, ± its standard deviation over labyrinths; an episode that fails
returns -4. Figures of several seeds are means; in brackets, 95% bootstrap intervals over seeds and
labyrinths. `paper`: Tables 3 to 5 of the supplement, which do not say with which encoder; {MARK}
marks cells that cannot be, since even the shortest routes would return less than AER and SR imply.

The runs themselves are in `runs/`, all of this as numbers is in `results.csv`, and as LaTeX in
`results.tex`. `labyrinth-datasets stages=[results]` makes these files.
"""

COLUMNS = (
    *("config", "setup", "method", "split", "source", "seeds"),
    *("sr", "sr_low", "sr_high", "aer", "aer_std", "aer_low", "aer_high"),
    *("path_efficiency", "accuracy_on_demonstrations", "accuracy_elsewhere"),
    *("loop", "wall", "ice", "possible"),
)
"""Of the CSV."""

Group = tuple[str, str]
"""Config and setup."""


def write_tables(
    folder: Path, evaluations: Sequence[Evaluation], figures: Sequence[Figures]
) -> None:
    """Write `README.md`, `results.csv` and `results.tex` into a folder."""
    groups: dict[Group, list[Figures]] = {}
    for each in figures:
        groups.setdefault((each.config, each.setup), []).append(each)
    parts = [ABOUT]
    for (config, setup), group in groups.items():
        runs = [each for each in evaluations if (each.config, each.setup) == (config, setup)]
        parts += [f"## {config}, {setup}\n", *(part + "\n" for part in markdown(group, runs))]
    write_text(folder / "README.md", "\n".join(parts))
    write_text(folder / "results.csv", as_csv(figures))
    write_text(folder / "results.tex", "\n".join(latex(group) for group in groups.values()))


def markdown(group: Sequence[Figures], runs: Sequence[Evaluation]) -> Iterator[str]:
    """Yield the tables of one config and setup."""
    methods = methods_of(group)
    names = [METHODS.get(method, method) for method in methods]
    yield table(["split", "", "", *names], compared(group, methods), "lll" + "r" * len(names))
    yield "What needs no learning:"
    heading = ["split", "", *(name.replace("_", " ") for name in BASELINES)]
    yield table(heading, _baseline_rows(runs[0]), "ll" + "r" * len(BASELINES))
    yield "Where an episode ends, and how good the actions are in all states, in percent:"
    heading = ["method", "split", "solved", "loop", "wall", "ice", "path efficiency"]
    heading += ["optimal actions on demonstrations", "elsewhere"]
    yield table(heading, map(_detail, group), "ll" + "r" * 7)
    yield "By moves on a shortest route, episodes that succeed, of all:"
    lengths = sorted({moves for each in group for moves in each.by_distance})
    yield table(
        ["method", "split", *map(str, lengths)],
        _by_distance(group, lengths),
        "ll" + "r" * len(lengths),
    )
    yield "SR on train less that on test, in points, and what the runs took:"
    heading = ["method", "seeds", "gap", "epochs", "epoch selected", "minutes", "device"]
    yield table(heading, map(_taken, _by_method(runs)), "lrrrrrl")


def methods_of(group: Sequence[Figures]) -> list[str]:
    """Return the methods of a table's columns: the paper's, if it has this config, then ours."""
    in_paper = [name for config, _, name in paper_figures() if config == group[0].config]
    return list(dict.fromkeys([*in_paper, *(each.method for each in group)]))


def compared(group: Sequence[Figures], methods: Sequence[str]) -> Iterator[list[str]]:
    """Yield the rows of a comparison: for each split SR and AER, of the paper and here."""
    here = {(each.split, each.method): each for each in group}
    paper = paper_figures()
    for split in EVALUATED_SPLITS:
        printed = [paper.get((group[0].config, split, method)) for method in methods]
        measured = [here.get((split, method)) for method in methods]
        for name, told, found in (("SR", paper_sr, our_sr), ("AER", paper_aer, our_aer)):
            if any(printed):
                yield [
                    split,
                    name,
                    "paper",
                    *("" if each is None else told(each) for each in printed),
                ]
            yield [split, name, "here", *("" if each is None else found(each) for each in measured)]


def paper_sr(figure: PaperFigure) -> str:
    """Return the SR that the paper prints."""
    return f"{100 * figure.sr:.1f}{'' if figure.is_possible else ' ' + MARK}"


def paper_aer(figure: PaperFigure) -> str:
    """Return the AER that the paper prints."""
    mark = "" if figure.is_possible else " " + MARK
    return f"{figure.aer:.2f} ± {figure.aer_std:.2f}{mark}"


def our_sr(figures: Figures) -> str:
    """Return our SR with its interval."""
    low, high = figures.sr_interval
    return f"{100 * figures.sr:.1f} [{100 * low:.1f}, {100 * high:.1f}]"


def our_aer(figures: Figures) -> str:
    """Return our AER with its interval."""
    low, high = figures.aer_interval
    return f"{figures.aer:.2f} ± {figures.aer_std:.2f} [{low:.2f}, {high:.2f}]"


def _baseline_rows(evaluation: Evaluation) -> Iterator[list[str]]:
    for split in EVALUATED_SPLITS:
        told = [evaluation.content["baselines"][split][name] for name in BASELINES]
        yield [split, "SR", *(f"{100 * each['sr']:.1f}" for each in told)]
        yield [split, "AER", *(f"{each['aer']:.2f} ± {each['aer_std']:.2f}" for each in told)]


def _detail(each: Figures) -> list[str]:
    shares = [
        each.sr,
        *(each.failures[name] for name in ("loop", "wall", "ice")),
        each.path_efficiency,
        each.accuracy_on_demonstrations,
        each.accuracy_elsewhere,
    ]
    return [METHODS.get(each.method, each.method), each.split, *map(_percent, shares)]


def _percent(share: float | None) -> str:
    return "" if share is None else f"{100 * share:.1f}"


def _by_distance(group: Sequence[Figures], lengths: Sequence[int]) -> Iterator[list[str]]:
    for each in group:
        counts = [each.by_distance.get(moves) for moves in lengths]
        cells = ["" if count is None else f"{count[0]} of {count[1]}" for count in counts]
        yield [METHODS.get(each.method, each.method), each.split, *cells]


def _by_method(runs: Sequence[Evaluation]) -> Iterator[list[Evaluation]]:
    for method in dict.fromkeys(each.method for each in runs):
        yield [each for each in runs if each.method == method]


def _taken(runs: Sequence[Evaluation]) -> list[str]:
    """Return a method's gap and what its runs took."""
    told = [each.content["training"] for each in runs]
    points, low, high = (100 * share for share in gap(runs))
    return [
        METHODS.get(runs[0].method, runs[0].method),
        str(len(runs)),
        f"{points:.1f} [{low:.1f}, {high:.1f}]",
        _listed(each["epochs"] for each in told),
        _listed(each["selected"]["epoch"] for each in told),
        f"{mean(each['seconds'] for each in told) / 60:.1f}",
        _listed(each["computed"]["device"] for each in told),
    ]


def _listed(values: Iterable[object]) -> str:
    return ", ".join(dict.fromkeys(map(str, values)))


def as_csv(figures: Sequence[Figures]) -> str:
    """Return all figures, ours and the paper's, one row each; shares, not percent."""
    rows = [
        {
            "config": config,
            "method": method,
            "split": split,
            "source": "paper",
            "sr": each.sr,
            "aer": each.aer,
            "aer_std": each.aer_std,
            "possible": each.is_possible,
        }
        for (config, split, method), each in paper_figures().items()
    ]
    for figure in figures:
        row = asdict(figure) | figure.failures | {"source": "here", "possible": True}
        for name in ("sr", "aer"):
            row[f"{name}_low"], row[f"{name}_high"] = row.pop(f"{name}_interval")
        rows.append(row)
    text = io.StringIO()
    writer = csv.DictWriter(text, COLUMNS, extrasaction="ignore", lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


def latex(group: Sequence[Figures]) -> str:
    """Return the comparison of one config and setup as a LaTeX table (package booktabs)."""
    methods = methods_of(group)
    first = group[0]
    lines = [
        f"% {first.config}, {first.setup}",
        rf"\begin{{tabular}}{{lll{'r' * len(methods)}}}",
        r"\toprule",
        _latex_row(["Split", "", "", *(METHODS.get(method, method) for method in methods)]),
        r"\midrule",
        *(_latex_row(row) for row in compared(group, methods)),
        r"\bottomrule",
        r"\end{tabular}",
    ]
    return "\n".join(lines) + "\n"


def _latex_row(cells: Sequence[str]) -> str:
    replaced = {"_": r"\_", "±": r"$\pm$", MARK: r"$^\dagger$", "-": "$-$"}
    text = " & ".join(cells)
    return "".join(replaced.get(letter, letter) for letter in text) + r" \\"

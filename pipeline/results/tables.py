"""The files `README.md` and `results.csv`: all trained methods, with the paper's figures.

`exchange_test` says whether methods differ significantly over their training runs. The unit is a
training run: each seed gives another policy, and the question is whether a method is better over
seeds, on these labyrinths.
"""

from __future__ import annotations

import csv
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cache
from itertools import combinations, groupby
from math import comb
from pathlib import Path
from statistics import mean

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.data import SPLITS
from labyrinth_core.evaluation import Results
from labyrinth_core.world import RULES
from pipeline.inspection import holm
from pipeline.machinery import count, plain, table
from pipeline.results.leaderboard import RANKED_BY, Entry, as_csv, name_of, percent_cell, run_of

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


RESAMPLES = 10_000
"""The maximum number of divisions in a test."""

FEWEST = 5
"""A pair of methods is tested if each has at least this number of runs."""

LEVEL = 0.05
"""The significance level: a difference counts if its p-value is at most this."""

_DIGITS = 12
"""Scores that are equal to this number of decimal places are equal."""

_CLOSE = 1e-9
"""The rounding error allowed between equal statistics; also the variance, in parts of that of all
scores, which counts as none."""

Rates = Mapping[str, NDArray[np.float64]]
"""Method -> the success rates of its runs, shape (runs,)."""


def interquartile_mean(scores: NDArray[np.float64]) -> float:
    """Return the mean of the middle half of scores, shape (runs,).

    See Agarwal et al. (2021), "Deep reinforcement learning at the edge of the statistical
    precipice". The lowest and the highest quarter, rounded down, are left out. Over a few runs a
    bootstrap of this mean is too narrow (three runs of each of three sizes: 78% instead of 95%), so
    it has no interval.
    """
    cut = len(scores) // 4
    return float(np.sort(scores)[cut : len(scores) - cut].mean())


def exchange_test(mine: NDArray[np.float64], others: NDArray[np.float64]) -> float:
    """Return the two-sided p-value of a permutation test of equal means.

    It is the share of all divisions of the runs into groups of these sizes for which Welch's
    statistic, the difference of the means divided by its standard error, is at least as large; if
    there are more than `RESAMPLES` divisions, the share in that many random ones.

    If both methods have the same distribution, the rate of false positives is at most the level,
    for any number of runs (Fisher 1935, "The design of experiments"; Phipson and Smyth 2010). If
    only their means are equal, it approaches the level as the runs increase, because the statistic
    is studentised (Janssen 1997; Chung and Romano 2013). At a level of 5%, with standard deviations
    of 1 and 0.1: 10% for 5 and 5 runs, up to 11% for 5 and 19, 7% for 10 and 10. With fewer than
    `FEWEST` runs it is higher, so `differences_of` leaves them out.

    Args:
        mine: The scores of one method's runs, shape (runs,), two at least.
        others: The scores of the other method's runs, shape (runs,), two at least.
    """
    scores = np.concatenate([mine, others]).round(_DIGITS)
    if np.ptp(scores) == 0:
        return 1.0
    scores -= scores.mean()
    chosen = _divisions(len(mine), len(others))
    (mean, error), (other_mean, other_error) = (
        _mean_and_error(group @ scores, group @ scores**2, int(group[0].sum()))
        for group in (chosen, 1 - chosen)
    )
    least = _CLOSE * float(scores.var())
    statistics = (mean - other_mean) ** 2 / np.maximum(error + other_error, least)
    return float((statistics >= statistics[0] * (1 - _CLOSE) - _CLOSE).mean())


def _mean_and_error(
    sums: NDArray[np.float64], squares: NDArray[np.float64], runs: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the means of groups of runs, and the squares of their standard errors.

    Args:
        sums: The sum of the scores of each group, shape (divisions,).
        squares: The sum of their squares, shape (divisions,).
        runs: The number of runs of a group.
    """
    means = sums / runs
    return means, (squares / runs - means**2) / (runs - 1)


@cache
def _divisions(first: int, second: int) -> NDArray[np.float64]:
    """Return the divisions of runs into two groups, shape (divisions, runs), the actual one first.

    A 1 puts a run into the first group, a 0 into the second.
    """
    runs = first + second
    if comb(runs, first) <= RESAMPLES:
        chosen = np.zeros((comb(runs, first), runs))
        for row, group in zip(chosen, combinations(range(runs), first), strict=True):
            row[list(group)] = 1
        return chosen
    actual = (np.arange(runs) < first).astype(np.float64)
    drawn = np.random.default_rng(0).permuted(np.tile(actual, (RESAMPLES - 1, 1)), axis=1)
    return np.concatenate([actual[None], drawn])


def differences_of(rates: Rates) -> dict[tuple[str, str], float]:
    """Return the p-value of each pair of methods, corrected for all pairs (Holm 1979).

    Methods with fewer than `FEWEST` runs are left out.
    """
    enough = [name for name, each in rates.items() if len(each) >= FEWEST]
    p_values = {
        (one, other): exchange_test(rates[one], rates[other])
        for one, other in combinations(enough, 2)
    }
    return dict(zip(p_values, holm([*p_values.values()]).tolist(), strict=True))


def conclusion(rates: Rates) -> str:
    """Say which of two or more methods differ, and which have too few runs to tell."""
    p_values = differences_of(rates)
    few = [name for name, each in rates.items() if len(each) < FEWEST]
    verdicts = [_verdict(rates, p_values)] if p_values else []
    if few:
        verdicts.append(f"No verdict on {', '.join(few)}: it takes {FEWEST} runs of each method.")
    return " ".join(verdicts)


def _verdict(rates: Rates, p_values: Mapping[tuple[str, str], float]) -> str:
    """Say which pairs differ; `found` has their p-values."""
    held = f"at a level of {LEVEL:.0%} over {count(len(p_values), 'pair')}"
    worse: dict[str, list[str]] = {}
    for pair in (each for each, p in p_values.items() if p <= LEVEL + _CLOSE):
        better, other = sorted(pair, key=lambda name: -rates[name].mean())
        worse.setdefault(better, []).append(other)
    if worse:
        apart = (f"{better} than {', '.join(others)}" for better, others in worse.items())
        return f"Significantly better, {held}: {'; '.join(apart)}."
    least = len(p_values) * min(
        exchange_test(np.zeros(len(rates[one])), np.ones(len(rates[other])))
        for one, other in p_values
    )
    if least > LEVEL:
        return (
            f"With so few seeds no difference can be significant, {held}: the least possible "
            f"p-value is {min(1.0, least):.2f}."
        )
    return f"No difference between methods is significant, {held}."


@dataclass(frozen=True)
class PaperFigure:
    """A cell of Tables 3 to 5 of the paper's supplement, as printed."""

    size: int
    """The number of rows and of columns of the labyrinths."""
    split: str
    method: str
    aer: float
    aer_std: float
    sr: float
    """A share, not percent."""

    @property
    def greatest_return(self) -> float:
        """The maximum return of a solved labyrinth.

        From corner to corner of n x n cells a route has at least 2 (n - 1) moves; from another
        start it has at least n moves.
        """
        moves = self.size if self.split.startswith("s0") else 2 * (self.size - 1)
        return RULES.goal_reward - (moves - 1) * RULES.step_penalty / self.size**2

    @property
    def is_possible(self) -> bool:
        """Whether a policy can have this AER together with this SR.

        Every episode that fails returns -4, so AER = SR * r + (1 - SR) * (-4), where r is the mean
        return of the episodes that succeed, at most `greatest_return`.
        """
        truncated = -RULES.step_limit * RULES.step_penalty
        most = self.sr * self.greatest_return + (1 - self.sr) * truncated
        return self.aer <= most + 0.005  # AER is printed with two digits.


@cache
def paper_figures() -> dict[tuple[str, str, str], PaperFigure]:
    """Return all cells, by config (such as `5x5`), split and method."""
    text = Path(__file__).with_name("paper.csv").read_text(encoding="utf-8")
    return {
        (row["size"], row["split"], row["method"]): PaperFigure(
            size=int(row["size"].partition("x")[0]),
            split=row["split"],
            method=row["method"],
            aer=float(row["aer"]),
            aer_std=float(row["aer_std"]),
            sr=float(row["sr_percent"]) / 100,
        )
        for row in csv.DictReader(text.splitlines())
    }

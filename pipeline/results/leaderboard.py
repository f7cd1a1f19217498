"""The leaderboard: methods on a dataset, ranked by their figures over all seeds.

An entry is a method on a dataset. `leaderboard.md` and `leaderboard.csv` show the ranked entries.
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from typing import Any
from urllib.parse import quote

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.data import SPLITS
from labyrinth_core.evaluation import Description, Results, RunName, TrainedRun
from labyrinth_core.language import parse_size
from pipeline.config import TrainingOptions
from pipeline.machinery import count, plain, table

RANKED_BY = "test"
"""The split whose SPL decides the rank: no method learns from its structures."""

AUTHOR = "Labyrinth datasets"
"""The author of runs of the stages `train` and `evaluate`."""

IN_PRINT = {
    "bc": "BC",
    "dagger": "DAgger",
    "gail": "GAIL",
    "bco": "BCO",
    "sqil": "SQIL",
    "iupe": "IUPE",
}
"""Method -> its name in print, in the order of the paper's tables."""

Figures = dict[str, Any]
"""The figures on a split by name, as in `results.csv`; shares, not percent."""

_FORMULA = re.compile(r"(?=[=+\-@\t\r])")
"""Matches the start of a text that a spreadsheet would read as a formula."""


def name_of(method: str) -> str:
    """Return the name of a method in Markdown."""
    return IN_PRINT.get(method) or plain(method)


def title_of(run: RunName) -> str:
    """Return the name of a run on the leaderboard, without its seed, such as `BC, cnn`."""
    name = IN_PRINT.get(run.method, run.method)
    return name if run.setup == run.method else f"{name}, {run.setup}"


def run_of(results: Results) -> TrainedRun:
    """Return the run that trained the evaluated policy; the results have to be of a run."""
    assert results.run is not None  # Results of other policies are kept separately.
    return results.run


@dataclass(frozen=True, eq=False)
class Entry:
    """A method on a dataset: training runs that differ only in their seed, or another policy."""

    results: Sequence[Results]
    """The results of each run, or of the other policy."""
    about: Description
    figures: Mapping[str, Figures]
    """Split -> its figures."""
    compared: bool = False
    """Whether the dataset was available, so that the results were checked against it."""
    replayed: int = 0
    """The number of `results` whose policy was played again, with the same episodes."""
    rank: int | None = None
    """One plus the number of entries whose whole SPL interval is above this entry's; None if it was
    not checked, or solves nothing on `RANKED_BY` or was not evaluated there."""

    @property
    def config(self) -> str:
        """The config of the dataset, such as `5x5`."""
        return self.results[0].config

    @property
    def run(self) -> TrainedRun:
        """The first training run; the entry has to be of runs."""
        return run_of(self.results[0])

    @property
    def rates(self) -> NDArray[np.float64]:
        """The success rate of each run on `RANKED_BY`, shape (runs,)."""
        return np.array([each.splits[RANKED_BY].sr for each in self.results])


def entries_of(
    results: Iterable[Results],
    is_compared: Callable[[Results], bool] = lambda _: False,
    is_replayed: Callable[[Results], bool] = lambda _: False,
) -> list[Entry]:
    """Return an entry for each trained method and for each submission.

    Args:
        results: Runs in the order of `kept.comparable`, and submissions.
        is_compared: Whether results were checked against their dataset.
        is_replayed: Whether the policy was played again.
    """

    def method(each: Results) -> object:
        return each if each.run is None else (each.config, each.run.of_all_seeds)

    entries = []
    for group in (list(group) for _, group in groupby(results, method)):
        first = group[0]
        splits = [split for split in first.splits if all(split in each.splits for each in group)]
        figures = {split: Results.over_seeds(group, split) for split in splits}
        about = first.about if first.run is None else _described(first.run, figures)
        replayed = sum(map(is_replayed, group))
        entries.append(Entry(group, about, figures, is_compared(first), replayed))
    return entries


def _described(run: TrainedRun, figures: Mapping[str, Figures]) -> Description:
    labyrinths = run.first_labyrinths or figures["train"]["labyrinths"]
    return Description(
        name=title_of(run),
        author=AUTHOR if run.method in TrainingOptions.METHODS else "",
        budget=count(run.training["epochs"], "epoch"),
        details={} if run.train_labyrinths == run.FRESH else {"labyrinths": labyrinths},
    )


def boards(entries: Iterable[Entry]) -> list[list[Entry]]:
    """Return the ranked entries of each dataset, in order, with the smallest labyrinths first."""

    def dataset(entry: Entry) -> tuple[Any, ...]:
        size = parse_size(entry.config.partition("-")[0])
        return size, entry.config, entry.results[0].fingerprint

    groups = groupby(sorted(entries, key=dataset), dataset)
    return [_ranked(list(group)) for _, group in groups]


def _ranked(entries: Sequence[Entry]) -> list[Entry]:
    """Rank the entries of one dataset, and return them in order."""
    solving = (each for each in entries if each.figures.get(RANKED_BY, {}).get("spl"))
    checked = [each for each in solving if each.compared]
    lows: list[float] = [each.figures[RANKED_BY]["spl_low"] for each in checked]

    def rank(entry: Entry) -> int | None:
        if entry not in checked:
            return None
        high: float = entry.figures[RANKED_BY]["spl_high"]
        return 1 + sum(low > high for low in lows)

    def place(entry: Entry) -> tuple[Any, ...]:
        spl = entry.figures[RANKED_BY]["spl"] if RANKED_BY in entry.figures else -1.0
        return entry.rank is None, entry.rank or 0, -spl, entry.about.name

    return sorted((replace(each, rank=rank(each)) for each in entries), key=place)


def percent_cell(figures: Figures, name: str) -> str:
    """Return a share in percent with its interval."""
    share, low, high = (100 * figures[f"{name}{end}"] for end in ("", "_low", "_high"))
    return f"{share:.1f} [{low:.1f}, {high:.1f}]"


def as_csv(columns: Sequence[str], rows: Iterable[Mapping[str, object]]) -> str:
    """Return a table as CSV; an apostrophe precedes texts that look like a formula.

    Args:
        columns: The names of the columns, in order.
        rows: The values of each row by column; values of other columns are left out.
    """
    text = io.StringIO()
    writer = csv.DictWriter(text, columns, extrasaction="ignore", lineterminator="\n")
    writer.writeheader()
    writer.writerows(
        {
            name: f"'{value}" if isinstance(value, str) and _FORMULA.match(value) else value
            for name, value in row.items()
        }
        for row in rows
    )
    return text.getvalue()


LEADERBOARD = "leaderboard.md"

MARK = "†"
"""Marks an entry that was not checked against the dataset, and so has no rank."""

BESIDE = {"random": "random steps", "route_memory": "route memory"}
"""Baseline -> its name in the tables, for the baselines that stand beside the methods."""
MEMORISED = "follows its own train"
"""The column of receipts, on boards that have any."""

ABOUT = f"""## How to read it

Methods are ranked by SPL on `{RANKED_BY}`, whose structures no method trains on. {Results.WHY_SPL}

SPL: moves on a shortest route divided by moves taken, 0 if unsolved, averaged, in percent. SR:
share of episodes that reach the goal, in percent; *within n x n*, in as many steps as there are
cells. n: the labyrinths of `{RANKED_BY}`. AER: average episodic return, ± its standard deviation.
Path efficiency: moves on a shortest route divided by moves taken, in percent, averaged over solved
episodes. In brackets: 95% intervals over labyrinths, and over seeds if there are several. The
interval of one seed says how this policy does on other labyrinths, not how another seed does.

A rank is one more than the number of methods whose interval of SPL lies wholly above. Methods whose
intervals overlap are not claimed to differ; `README.md` tests whether they differ over seeds, by
exchanging runs. A method that solves nothing has no rank. {MARK}: the dataset was not available, so
the outcomes are unchecked and the method has no rank.

Computed without a rank: random steps (exact expectations), and route memory, which knows all walls
and takes the shortest part of a route of train that is open. What a method achieves beyond it is
learnt.

All figures are computed from the outcome and the moves of each episode. Replayed:
`labyrinth-datasets stages=results results.replay=true` opened the policy and played the same
episodes. Organiser's word: the episodes are possible, and whether the policy played them rests on
the word of whoever made the file. The training data of a method are as its authors state them; an
empty cell is not stated.

`leaderboard.csv` has the same figures. `labyrinth-datasets stages=results` makes both files from
`runs/` and `submissions/`.
"""

COLUMNS = (
    *("config", "fingerprint", "rank", "method", "author", "url", "date", "budget"),
    *("train_labyrinths", "train_steps", "parameters"),
    *("observation", "seeds", "episodes", "version", "compared"),
    *("split", "labyrinths", "spl", "spl_low", "spl_high", "sr_within_cells"),
    *("sr", "sr_low", "sr_high"),
    *("aer", "aer_std", "aer_low", "aer_high", "path_efficiency", "replayed"),
)
"""The columns of `leaderboard.csv`."""


def leaderboard(boards: Sequence[Sequence[Entry]]) -> dict[str, str]:
    """Return the text of `leaderboard.md` and of `leaderboard.csv`, by name."""
    parts = ["# Leaderboard\n"]
    for entries in boards:
        parts += [part + "\n" for part in markdown(entries)]
    parts.append(ABOUT)
    rows = (row for entries in boards for entry in entries for row in _rows(entry))
    return {LEADERBOARD: "\n".join(parts), "leaderboard.csv": as_csv(COLUMNS, rows)}


def markdown(entries: Sequence[Entry]) -> Iterator[str]:
    """Yield the heading and the tables of one dataset, the ranks first."""
    yield f"## {entries[0].config}"
    heading = ["rank", "method", "SPL", "SR", "n", "outcomes"]
    yield table(heading, [*map(_place, entries), *_baselines(entries)], "rlrrrl")
    yield "On all splits:"
    held = {split for each in entries for split in each.figures}
    # The usual splits first, then the others in the order of the dataset.
    splits = [split for split in dict.fromkeys((*SPLITS.evaluated, *SPLITS)) if split in held]
    rows = (row for each in entries for row in _by_split(each, splits))
    yield table(["method", "", *splits], rows, "ll" + "r" * len(splits))
    yield "What they have learnt from, and how they were evaluated:"
    heading = [
        "method",
        "by",
        "budget",
        *Description.DETAILS,
        "seeds",
        "sees",
        "episodes",
        "version",
        "date",
    ]
    asked = any(each.memorised for entry in entries for each in entry.results)
    rows = ([*_effort(entry), *[_memorised(entry)] * asked] for entry in entries)
    yield table(
        [*heading, *[MEMORISED] * asked],
        rows,
        "lll" + "r" * len(Description.DETAILS) + "rlrll" + "l" * asked,
    )
    yield f"The dataset's fingerprint is `{entries[0].results[0].fingerprint}`."


_FIGURES = ("SPL", "SR within n x n", "SR", "AER", "path efficiency")


def _place(entry: Entry) -> list[str]:
    mine = entry.figures.get(RANKED_BY)
    rank = "" if entry.rank is None else str(entry.rank)
    figures = [""] * 3
    if mine is not None:
        figures = [*(percent_cell(mine, name) for name in ("spl", "sr")), f"{mine['labyrinths']:,}"]
    seeds, played = len(entry.results), entry.replayed
    outcomes = "replayed" if played == seeds else f"{played} of {seeds} replayed"
    return [rank, _name(entry, linked=True), *figures, outcomes if played else "organiser's word"]


def _baselines(entries: Sequence[Entry]) -> Iterator[list[str]]:
    """Yield a row for each baseline, from the first entry whose results were checked, if any."""
    with_it = [each for each in entries if RANKED_BY in each.results[0].splits]
    for entry in sorted(with_it, key=lambda each: not each.compared)[:1]:
        first = entry.results[0]
        for name, shown in BESIDE.items():
            if figures := first.baselines.get(name, {}).get(RANKED_BY):
                shares = (f"{100 * figures[figure]:.1f}" for figure in ("spl", "sr"))
                count = len(first.splits[RANKED_BY].distance)
                mark = "" if entry.compared else f" {MARK}"
                yield ["", f"{shown}{mark}", *shares, f"{count:,}", "computed"]


def _by_split(entry: Entry, splits: Sequence[str]) -> Iterator[list[str]]:
    shown = [entry.figures.get(split) for split in splits]
    cells = [[""] * 5 if each is None else _cells(each) for each in shown]
    for name, *row in zip(_FIGURES, *cells, strict=True):
        yield [_name(entry), name, *row]


def _cells(figures: Figures) -> list[str]:
    """Return the cells of `_FIGURES`."""
    efficiency = figures["path_efficiency"]
    return [
        percent_cell(figures, "spl"),
        f"{100 * figures['sr_within_cells']:.1f}",
        percent_cell(figures, "sr"),
        "{aer:.2f} ± {aer_std:.2f} [{aer_low:.2f}, {aer_high:.2f}]".format_map(figures),
        "" if efficiency is None else f"{100 * efficiency:.1f}",
    ]


def _effort(entry: Entry) -> list[str]:
    about, first = entry.about, entry.results[0]
    details = (
        f"{about.details[name]:,}" if name in about.details else "" for name in Description.DETAILS
    )
    evaluated = [str(len(entry.results)), plain(first.observation), str(first.episodes)]
    return [
        *(_name(entry), plain(about.author), plain(about.budget), *details),
        *(*evaluated, plain(first.version), about.date),
    ]


def _memorised(entry: Entry) -> str:
    """Return the excess over other training sets, and its p, for each run that was asked."""
    receipts = (each.memorised for each in entry.results)
    return "; ".join(f"{each.excess:+z.2f} (p {each.p:.3f})" for each in receipts if each)


def _name(entry: Entry, *, linked: bool = False) -> str:
    name, url = plain(entry.about.name), entry.about.url
    if linked and url:
        name = f"[{name}]({quote(url, safe=':/?#@!&*+,;=%~')})"
    return name if entry.compared else f"{name} {MARK}"


def _rows(entry: Entry) -> Iterator[dict[str, object]]:
    """Yield a row for each split; shares, not percent."""
    first, about = entry.results[0], entry.about
    same = vars(first) | vars(about) | {"method": about.name, "seeds": len(entry.results)}
    same |= {"rank": entry.rank, "compared": entry.compared, "replayed": entry.replayed}
    same |= {f"train_{name}": about.details.get(name) for name in ("labyrinths", "steps")}
    same["parameters"] = about.details.get("parameters")
    for split, figures in entry.figures.items():
        yield same | {"split": split} | figures

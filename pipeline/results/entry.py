"""An entry: a method on a dataset, with its figures over all seeds and its rank."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.evaluation import Description, Results, TrainedRun
from labyrinth_core.language import parse_size
from pipeline.config import TrainingOptions
from pipeline.machinery import count
from pipeline.results.kept import AUTHOR, run_of
from pipeline.results.paper import title_of

RANKED_BY = "test"
"""The split whose SPL decides the rank: no method learns from its structures."""

Figures = dict[str, Any]
"""The figures on a split by name, as in `results.csv`; shares, not percent."""

_FORMULA = re.compile(r"(?=[=+\-@\t\r])")
"""Matches the start of a text that a spreadsheet would read as a formula."""


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

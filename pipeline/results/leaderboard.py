"""The leaderboard: runs and submitted results, ranked on the same labyrinths."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import groupby
from operator import itemgetter
from pathlib import Path
from typing import Any
from urllib.parse import quote

from labyrinth_core.data.splits import SPLITS
from labyrinth_core.evaluation.description import DETAILS, Description
from labyrinth_core.evaluation.results import Results
from labyrinth_core.evaluation.scores import EVALUATED_SPLITS, WHY_SPL
from labyrinth_core.language.source_text import parse_size
from pipeline.config.training import METHODS
from pipeline.machinery.artifact import leave
from pipeline.machinery.markdown import count, plain, table
from pipeline.results.figures import Figures, MethodRuns, run_of
from pipeline.results.kept import AUTHOR, Available
from pipeline.results.paper import title_of
from pipeline.results.result_tables import aer_cell, percent_cell
from pipeline.results.spreadsheet import as_csv

RANKED_BY = "test"
"""The split whose SPL decides the rank: no method learns from its structures."""

LEADERBOARD = "leaderboard.md"

MARK = "†"
"""Marks an entry that was not checked against the dataset, and so has no rank."""

ABOUT = f"""# Leaderboard

Methods are ranked by SPL on `{RANKED_BY}`, whose structures no method trains on.
{WHY_SPL}

A rank is one more than the number of methods whose interval of SPL lies wholly above. Methods whose
intervals overlap are not claimed to differ. Ranks compare these policies: the intervals of a few
seeds are too narrow to predict another seed. `README.md` tests whether methods differ over seeds,
by exchanging runs. At 0% or 100% the interval is empty; do not read it as certainty.

SPL: moves on a shortest route divided by moves taken, 0 if unsolved, averaged, in percent. SR:
share of episodes that reach the goal, in percent; *within n x n*, in as many steps as there are
cells. AER: average episodic return, ± its standard deviation. Path efficiency: moves on a shortest
route divided by moves taken, in percent, averaged over solved episodes. In brackets: 95% bootstrap
intervals over labyrinths, and over seeds or episodes if there are several.

All figures are computed from the outcome and the moves of each episode. The training data of a
method are as its authors state them; an empty cell is not stated. {MARK}: the dataset was not
available, so the outcomes are unchecked and the method has no rank.

`leaderboard.csv` has the same figures. `labyrinth-datasets stages=results` makes both files from
`runs/` and `submissions/`.
"""

COLUMNS = (
    *("config", "fingerprint", "rank", "method", "author", "url", "date", "budget"),
    *("train_labyrinths", "train_steps", "parameters"),
    *("observation", "seeds", "episodes", "version", "compared"),
    *("split", "labyrinths", "spl", "spl_low", "spl_high", "sr_within_cells"),
    *("sr", "sr_low", "sr_high"),
    *("aer", "aer_std", "aer_low", "aer_high", "path_efficiency"),
)
"""The columns of `leaderboard.csv`."""


@dataclass(frozen=True)
class Entry:
    """A method on the leaderboard of a dataset."""

    config: str
    fingerprint: str
    """The fingerprint of the dataset's rows."""
    method: Description
    observation: str
    """What the policy observes: images, vectors or text."""
    seeds: int
    """The number of training runs."""
    episodes: int
    """The number of episodes in each labyrinth."""
    version: str
    """The version of the software that evaluated the policy; empty if it is not stated."""
    compared: bool
    """Whether the dataset was available, so that the results were checked against it."""
    figures: dict[str, Figures]
    """Split -> its figures."""
    rank: int | None = None
    """One plus the number of entries whose whole SPL interval is above this entry's; None without
    figures on `RANKED_BY`, and for an entry that was not checked."""


def entries_of(
    methods: Iterable[MethodRuns], submissions: Iterable[Results], available: Available
) -> Iterator[Entry]:
    """Yield an entry for each trained method and each submission.

    Args:
        methods: The methods of our runs.
        submissions: The results of other policies.
        available: The datasets that are available.
    """
    for ours in methods:
        yield _entry(ours.runs, _description(ours), ours.figures, available)
    for results in submissions:
        assert results.method is not None  # Always set in results from a file.
        figures = {split: Figures.over([results], split) for split in results.splits}
        yield _entry([results], results.method, figures, available)


def _description(method: MethodRuns) -> Description:
    run = run_of(method.runs[0])
    return Description(
        name=title_of(run),
        author=AUTHOR if run.method in METHODS else "",
        budget=count(run.training["epochs"], "epoch"),
        details={"labyrinths": run.train_labyrinths or method.figures["train"].labyrinths},
    )


def _entry(
    runs: Sequence[Results], method: Description, figures: dict[str, Figures], available: Available
) -> Entry:
    first = runs[0]
    return Entry(
        config=first.config,
        fingerprint=first.fingerprint,
        method=method,
        observation=first.observation,
        seeds=len(runs),
        episodes=first.episodes,
        version=first.version,
        compared=available.has(first),
        figures=figures,
    )


def boards(entries: Iterable[Entry]) -> list[list[Entry]]:
    """Return the ranked entries of each dataset, in order, with the smallest labyrinths first."""

    def dataset(entry: Entry) -> tuple[Any, ...]:
        size = parse_size(entry.config.partition("-")[0])
        return size, entry.config, entry.fingerprint

    groups = groupby(sorted(entries, key=dataset), dataset)
    return [_ranked(list(group)) for _, group in groups]


def _ranked(entries: Sequence[Entry]) -> list[Entry]:
    """Rank the entries of one dataset, and return them in order."""
    found = [each.figures.get(RANKED_BY) for each in entries]
    ranked = [each if entry.compared else None for entry, each in zip(entries, found, strict=True)]
    lows = [each.spl_interval[0] for each in ranked if each]
    placed = []
    for entry, figures, mine in zip(entries, found, ranked, strict=True):
        rank = 1 + sum(low > mine.spl_interval[1] for low in lows) if mine else None
        spl = figures.spl if figures else -1.0
        placed.append(
            ((rank is None, rank or 0, -spl, entry.method.name), replace(entry, rank=rank))
        )
    return [entry for _, entry in sorted(placed, key=itemgetter(0))]


def write_leaderboard(folder: Path, boards: Sequence[Sequence[Entry]]) -> None:
    """Write `leaderboard.md` and `leaderboard.csv` into a folder; raise as `artifact.leave`."""
    parts = [ABOUT]
    for entries in boards:
        parts += [part + "\n" for part in markdown(entries)]
    csv = csv_of([e for entries in boards for e in entries])
    files = {LEADERBOARD: "\n".join(parts).encode(), "leaderboard.csv": csv.encode()}
    leave(folder, files)


def markdown(entries: Sequence[Entry]) -> Iterator[str]:
    """Yield the heading and the tables of one dataset."""
    yield f"## {entries[0].config}"
    yield f"The dataset's fingerprint is `{entries[0].fingerprint}`."
    yield f"On {RANKED_BY}:"
    heading = ["rank", "method", "by", *_FIGURES, "labyrinths"]
    yield table(heading, map(_place, entries), "rllrrrrrr")
    yield "On all splits:"
    held = {split for each in entries for split in each.figures}
    # The usual splits first, then the others in the order of the dataset.
    splits = [split for split in dict.fromkeys((*EVALUATED_SPLITS, *SPLITS)) if split in held]
    rows = (row for each in entries for row in _by_split(each, splits))
    yield table(["method", "", *splits], rows, "ll" + "r" * len(splits))
    yield "What they have learnt from, and how they were evaluated:"
    heading = ["method", "budget", *DETAILS, "seeds", "sees", "episodes", "version", "date"]
    yield table(heading, map(_effort, entries), "ll" + "r" * len(DETAILS) + "rlrll")


_FIGURES = ("SPL", "SR within n x n", "SR", "AER", "path efficiency")


def _place(entry: Entry) -> list[str]:
    mine = entry.figures.get(RANKED_BY)
    rank = "" if entry.rank is None else str(entry.rank)
    figures = [""] * 6 if mine is None else [*_cells(mine), f"{mine.labyrinths:,}"]
    return [rank, _name(entry, linked=True), plain(entry.method.author), *figures]


def _by_split(entry: Entry, splits: Sequence[str]) -> Iterator[list[str]]:
    found = [entry.figures.get(split) for split in splits]
    cells = [[""] * 5 if each is None else _cells(each) for each in found]
    for name, *row in zip(_FIGURES, *cells, strict=True):
        yield [_name(entry), name, *row]


def _cells(figures: Figures) -> list[str]:
    """Return the cells of `_FIGURES`."""
    efficiency = figures.averages["path_efficiency"]
    return [
        percent_cell(figures.spl, figures.spl_interval),
        f"{100 * figures.sr_within_cells:.1f}",
        percent_cell(figures.sr, figures.sr_interval),
        aer_cell(figures),
        "" if efficiency is None else f"{100 * efficiency:.1f}",
    ]


def _effort(entry: Entry) -> list[str]:
    method = entry.method
    details = (f"{method.details[name]:,}" if name in method.details else "" for name in DETAILS)
    evaluated = [str(entry.seeds), plain(entry.observation), str(entry.episodes)]
    return [
        *(_name(entry), plain(method.budget), *details),
        *(*evaluated, plain(entry.version), method.date),
    ]


def _name(entry: Entry, *, linked: bool = False) -> str:
    name, url = plain(entry.method.name), entry.method.url
    if linked and url:
        name = f"[{name}]({quote(url, safe=':/?#@!&*+,;=%~')})"
    return name if entry.compared else f"{name} {MARK}"


def csv_of(entries: Sequence[Entry]) -> str:
    """Return all figures as CSV, one row per method and split; shares, not percent."""
    rows = (_row(entry, split) for entry in entries for split in entry.figures)
    return as_csv(COLUMNS, rows)


def _row(entry: Entry, split: str) -> dict[str, object]:
    method = entry.method
    row = asdict(replace(entry, figures={})) | asdict(method) | entry.figures[split].columns()
    row |= {"method": method.name, "split": split, "parameters": method.details.get("parameters")}
    return row | {f"train_{name}": method.details.get(name) for name in ("labyrinths", "steps")}
